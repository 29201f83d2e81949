"""What the page says is what the run's files say. Runs are written by hand: nothing is trained here."""

import io
from base64 import b64decode
from dataclasses import asdict, replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsjax import cli, config, pipeline, runs
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.pipeline.compare import compare
from gsjax.planning.sparse_views import Decision
from gsjax.presets import preset
from gsjax.rendering.gallery import Picture
from gsjax.report import view_pictures
from gsjax.report.curves import LEFT, RIGHT
from gsjax.report.page import record_stage, report
from gsjax.scene import Pixels, frame_of
from gsjax.training.plan import plan

SIZE = (64, 48)  # width, height
NAMES = [f"{index:02d} <b>&\"'.jpg" for index in range(9)]  # as a file may be called
K = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
VIEWMAT = np.eye(4)
EVIDENCE = {"on": True, "evidence": 0.31, "unit": "EV", "noise": 0.02, "threshold": 0.05, "note": "a<b"}


class Page(HTMLParser):
    """The rows of a page's tables, its pictures, and its lines."""

    def __init__(self, file):
        super().__init__()
        self.rows, self.pictures, self.lines, self.tags, self.text = [], {}, [], [], None
        self.feed(Path(file).read_text(encoding="utf-8"))
        self.cells = {row[0]: row[1:] for row in self.rows}

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.tags.append((tag, attributes))
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.text = ""
        elif tag == "img":
            self.pictures[attributes["alt"]] = attributes["src"]
        elif tag == "polyline":
            points = np.array([pair.split(",") for pair in attributes["points"].split()], float)
            self.lines.append((attributes["data-line"], points))

    def handle_data(self, data):
        if self.text is not None:
            self.text += data

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self.rows[-1].append(self.text.strip())
            self.text = None


def picture(uri):
    head, data = uri.split(",")
    assert head == "data:image/jpeg;base64"
    return Image.open(io.BytesIO(b64decode(data)))


def made_run(folder, *, seed=0, losses=(0.5, 0.25, 0.125), psnr=25.0, done=True, **settings):
    """A run folder as training leaves it, without its Gaussians and checkpoints."""
    whole = preset("fast", {"seed": seed, "photos": {"downscale": 2.0}, **settings})
    planned = replace(plan(whole), downscale=2.0).record()
    runs.create(folder, config.to_dict(whole), scene=folder.parent / "scene <i>", seed=seed, plan=planned)
    for index, loss in enumerate(losses):
        held_out = {"held_out_psnr": 20.0 + index} if index else {}
        phase = "coarse" if index < 2 else "vanilla"
        record = {"step": 50 * (index + 1), "seconds": 7.0 * (index + 1) + seed, "loss": loss, "psnr": 10 + index}
        runs.append_metrics(folder, {**record, "gaussians": 100 * index, "phase": phase, **held_out})
    if not done:
        return folder
    records = [
        {"name": name, "width": SIZE[0], "height": SIZE[1], "viewmat": VIEWMAT, "K": K, "held_out": index % 2 == 1}
        for index, name in enumerate(NAMES)
    ]
    json_files.write(folder / "cameras.json", records)
    keep = view_pictures.picture_keeper(folder)
    for index, record in enumerate(records):
        photo, flat = np.full((SIZE[1], SIZE[0], 3), 20 * index, np.uint8), np.ones((SIZE[1], SIZE[0]), np.float32)
        frame = frame_of(record["name"], VIEWMAT.astype(np.float32), K.astype(np.float32), Pixels(photo))
        if record["held_out"]:  # nothing is rendered for the page
            keep(frame, photo / np.float32(255), Picture(1 - photo / np.float32(255), flat, flat, flat))
    summary = {"psnr": psnr, "ssim": 0.8125, "views": 4, "gaussians": 1234, "steps": 200, "train_seconds": 30.5 + seed}
    runs.update_manifest(folder, status="done", peak_gib=1.25, photos="9 photos at 64x48 (taken at 128x96)", **summary)
    return folder


@pytest.fixture
def run(tmp_path):
    return made_run(tmp_path / "run <script>")


def test_the_page_says_what_the_files_say(run):
    evidence = {"exposure": EVIDENCE, "blur": {**EVIDENCE, "on": False, "evidence": None, "noise": None}}
    runs.update_manifest(run, effects={"simulated": ["exposure"], "evidence": evidence})
    Image.new("RGB", SIZE).save(run / "pictures/0001_sky.jpg")
    page = Page(report(run))
    assert f"sky, {NAMES[1]}" in page.pictures
    assert page.cells["psnr"] == ["25"] and page.cells["gaussians"] == ["1,234"]
    assert page.cells["train"] == ["30.5", "1.25", "psnr 25, ssim 0.8125, gaussians 1,234"]
    assert page.cells["Size of the photos"] == ["reduced 2 times", "9 photos at 64x48 (taken at 128x96)"]
    assert page.cells["Photos for scoring"][0] == "4 of 9"
    assert page.cells["Normals"][0] == "self-supervised, of the rendered depth, smoothed"
    runs.update_manifest(run, stereo="depth and normals of 9 of 9 photos")
    assert Page(report(run)).cells["Normals"] == ["of multi-view stereo", "depth and normals of 9 of 9 photos"]
    assert page.cells["exposure"] == ["simulated", "0.31 EV", "0.02 EV", "0.05 EV", "a<b"]
    assert page.cells["blur"] == ["no", "-", "-", "0.05 EV", "a<b"]
    terms = "l1 0.8, dssim 0.2, pixel_normal 0.1, multi_view 0.06, photometric 0.3, measured_depth 0.05, alpha 0.1"
    assert page.cells["surface"] == ["700", terms]
    assert page.cells["schedule.phases.2.weights.pixel_normal"] == ["0.1"]
    assert page.cells["jax"] == [json_files.read(run / "manifest.json")["versions"]["jax"]]


def _with_dropout(plan):
    return plan | {"phases": [phase | {"dropout": 0.3} for phase in plan["phases"]]}


@pytest.mark.parametrize(
    ("alone", "reason"),
    [
        (False, "sparse-view regularization: few photos, or far apart"),
        (True, "a long run on 21 photos that are 14 degrees apart"),
    ],
)
def test_the_page_says_why_steps_leave_gaussians_out(run, alone, reason):
    decision = asdict(Decision(21, 14.4, None, None, held_back=not alone, dropout_alone=alone))
    for file, change in (
        ("plan.json", _with_dropout),
        ("manifest.json", lambda record: record | {"sparse_views": decision}),
    ):
        json_files.write(run / file, change(json_files.read(run / file)))
    assert Page(report(run)).cells["Left out of every step"] == ["30% of the Gaussians", reason]


def test_nothing_of_a_name_becomes_markup_and_nothing_is_loaded(run, capsys):
    page = Page(report(run))
    tags = [tag for tag, _ in page.tags]
    assert tags.count("script") == 1 and "b" not in tags and "i" not in tags
    links = [attributes for _, attributes in page.tags if "href" in attributes or "src" in attributes]
    assert all(link["src"].startswith("data:") for link in links)
    assert "http:" not in (text := (run / "report.html").read_text()) and "https:" not in text
    (run / "report.html").unlink()
    (run / "report.html").mkdir()
    assert record_stage(run, "eval", lambda: {"psnr": 26.5}) == {"psnr": 26.5}, "work is not lost with its report"
    assert "report: cannot write" in capsys.readouterr().err


def test_the_lines_are_the_metrics(run):
    """Three charts against steps, then against seconds; the last score of the held-out views ends its line."""
    page = Page(report(run))
    names = ["loss", "training view", "held-out views", "Gaussians"]
    assert [name for name, _ in page.lines] == 2 * names
    loss, _, held_out, _ = (points for _, points in page.lines[:4])
    np.testing.assert_allclose(loss[:, 0], LEFT + (RIGHT - LEFT) * np.array([1, 2, 3]) / 3, atol=0.01)
    drops = np.diff(loss[:, 1])
    assert drops[0] == pytest.approx(2 * drops[1], abs=0.02), "0.5, 0.25, 0.125; y points down"
    np.testing.assert_allclose(held_out[:, 0], LEFT + (RIGHT - LEFT) * np.array([100, 150, 200]) / 200, atol=0.01)
    seconds = page.lines[6][1]
    np.testing.assert_allclose(seconds[:, 0], LEFT + (RIGHT - LEFT) * np.array([14, 21, 30.5]) / 30.5, atol=0.01)


def test_a_run_that_is_not_finished_shows_what_there_is(tmp_path):
    page = Page(report(made_run(tmp_path / "run", done=False)))
    assert page.cells["State"] == ["not finished: 150 of 2,150 steps logged"]
    assert not page.pictures and page.lines
    runs.create(tmp_path / "begun", json_files.read(tmp_path / "run/config.json"), scene=tmp_path, seed=0)
    assert not Page(report(tmp_path / "begun")).lines


def test_a_scan_is_one_page_of_its_stages_and_runs(tmp_path):
    made_run(tmp_path / "scan/run")
    stages = {"sfm": {"registered": 9, "seconds": 3.5, "peak_gib": 0.5}, "train": {"psnr": 25.0, "seconds": 40.0}}
    json_files.write(tmp_path / "scan/report.json", {"asked": {}, "stages": stages})
    Image.new("RGB", (2600, 260), (10, 20, 30)).save(tmp_path / "scan/overview.png")
    page = Page(report(tmp_path / "scan"))
    assert page.cells["sfm"] == ["3.5", "0.5", "registered 9"] and page.cells["train"][0] == "40"
    assert picture(page.pictures["one view as Gaussians, as normals, and as the meshes"]).size == (1280, 128)


def test_bad_input_is_one_line_and_leaves_nothing(run, tmp_path, capsys):
    """Folders of no run, cameras without which runs are compared, and metrics."""
    for name in ("empty", "scan"):
        (tmp_path / name).mkdir()
    json_files.write(tmp_path / "scan/report.json", {"vanilla": {}})
    (run / "cameras.json").write_text("[{")
    damaged = made_run(tmp_path / "damaged")
    first, _, last = (damaged / "metrics.jsonl").read_text().splitlines()
    (damaged / "metrics.jsonl").write_text("\n".join([first, '{"step": 100, "lo', last, ""]))
    for command, expected in (
        (["report", tmp_path / "empty"], "holds no manifest.json; it is no run folder"),
        (["report", tmp_path / "scan"], "is the folder of neither a run nor a scan"),
        (["report", run], "cameras.json: is no JSON"),
        (["report", damaged], "metrics.jsonl, line 2: is no JSON"),
        (["compare", damaged, run, "--out", tmp_path / "c.html"], "metrics.jsonl, line 2: is no JSON"),
    ):
        assert cli.main([str(part) for part in command]) == 2
        message = capsys.readouterr().err
        assert expected in message and message.count("\n") == 1
    assert not list(tmp_path.rglob("*.html"))


def test_seeds_are_pooled_and_settings_that_differ_are_named(tmp_path):
    first = made_run(tmp_path / "a", seed=0, losses=(0.5, 0.3), psnr=25.0)
    second = made_run(tmp_path / "b", seed=2, losses=(0.3, 0.1), psnr=26.0)
    other = made_run(
        tmp_path / "c", losses=(0.4, 0.4), psnr=21.0, schedule={"vanilla": True}, model={"max_gaussians": 500}
    )
    page = Page(compare([first, other, second], tmp_path / "c.html"))
    assert page.rows[0] == ["", "a, 2 seeds", "c"]
    assert page.cells["psnr"] == ["25.5 [25 26]", "21"]
    assert page.cells["train_seconds"] == ["31.5 [30.5 32.5]", "30.5"]
    assert page.cells["schedule.vanilla"] == ["false", "true"] and page.cells["model.max_gaussians"] == ["60000", "500"]
    assert not {"seed", "sh_degree", "downscale"} & page.cells.keys()
    assert [row[1:3] for row in page.rows if row[0] == "a"] == [[str(first), "0"], [str(second), "2"]]
    assert [label for label, _ in page.lines] == 8 * ["a", "c"]
    a, c = (points for _, points in page.lines[4:6])
    assert a[0, 1] == pytest.approx(c[0, 1]), "the mean of 0.5 and 0.3 is 0.4"
    assert a[1, 1] > c[1, 1], "0.2 lies under 0.4"
    for names, out, message in ((["a"], "c.html", "nothing to compare .*a with"), (["a", "a"], "c.html", "named twice"),
                                (["a", "b"], "c.txt", "html")):  # fmt: skip
        with pytest.raises(InputError, match=message):
            pipeline.compare([tmp_path / name for name in names], tmp_path / out)
