"""The paper's protocol: its scenes are found, its runs survive, its tables tell values, spreads, dashes and doubts."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from small_scenes import built_in

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.images import image_size
from gsjax.meshing.export import read_mesh, read_textured

PATIENCE = 900  # seconds, on a machine with much else to do
SETTINGS = (
    "model.background=white",
    "model.max_gaussians=3000",
    "model.sh_degree=1",
    "schedule.phases.vanilla.steps=320",  # so that opacities are high enough for a surface
    "schedule.phases.entropy.steps=10",
    "schedule.phases.surface.steps=10",
    "density.start=20",
    "density.every=20",
    "logging.checkpoint_every=20",
    "logging.evaluate_every=0",
)
REFINEMENT = ("steps=10", "faces=1500", "sh_degree=1")


def place(root: Path, scene: str, images: str) -> Path:
    """A folder that looks like a published scene; no file of it can be read."""
    folder = root / scene
    for part in ("sparse/0", images):
        (folder / part).mkdir(parents=True)
    for file in ("cameras", "images", "points3D"):
        (folder / "sparse/0" / f"{file}.bin").touch()
    return folder


def test_published_figures_are_those_that_the_paper_prints(scripts, shared):
    published = scripts("paper.published")
    tex = shared / "paper" / "paper.tex"
    if not tex.is_file():
        pytest.skip("needs the paper's source beside the data sets")
    line = re.compile(r"^(.+?)\s*(?:\\cite\{\w+\})?\s*&\s*([\d.]+)\s*&\s*([\d.]+)\s*&\s*([\d.]+)\s*\\\\", re.MULTILINE)
    blocks = re.findall(r"\\begin\{tabular\}\{\|c\|ccc\|\}(.*?)\\end\{tabular\}", tex.read_text(), re.DOTALL)
    named = {"Mip-NeRF360": "Mip-NeRF 360", "Baked-SDF": "BakedSDF", "Mobile-NeRF": "MobileNeRF", "Ours": "The paper",
             "Ours (7K refinement)": "The paper (7K refinement)"}  # fmt: skip
    printed = [
        {named.get(name.strip(), name.strip()): tuple(map(float, numbers)) for name, *numbers in line.findall(block)}
        for block in blocks
    ]
    assert printed == list(published.PUBLISHED.values())


def test_scenes_are_found_in_the_root_and_in_the_archives_folders(scripts, tmp_path):
    places = {"garden": "360_v2", "room": "", "train": "tandt", "playroom": "db", "truck": "tandt_db/tandt"}
    images = {"garden": "images_4", "room": "images_2"}
    laid = {name: place(tmp_path / nest, name, images.get(name, "images")) for name, nest in places.items()}
    place(tmp_path, "flowers", "images_4")  # not of the paper
    discover = scripts("paper.scenes").discover
    folders, faults = discover(tmp_path)
    assert folders == laid and not faults
    assert list(folders) == ["room", "garden", "truck", "train", "playroom"], "the paper's order"
    with pytest.raises(InputError, match="holds none of room, counter"):
        discover(tmp_path / "db/playroom")
    place(tmp_path / "360_v2", "room", "images_2")
    with pytest.raises(InputError, match="room is there twice"):
        discover(tmp_path)


@pytest.fixture
def study(scripts, tmp_path):
    """`reproduce` over two scenes, with a stand-in for the process that writes what it is told to."""
    for name in ("room", "kitchen"):
        place(tmp_path / "data", name, "images_2")
    module, paper_run = scripts("reproduce"), scripts("paper_run")

    class Study:
        out, started = tmp_path / "out", []
        codes: dict = {}  # by scene; absent: 0

        def start(self, job, options):
            self.started.append((job.scene, job.schedule, job.seed))
            code = self.codes.get(job.scene, 0)
            wishes = paper_run.run_settings(job.scene, job.schedule, job.seed, options.assignments, options.refinement)
            result = {"asked": wishes, "lpips": list(options.lpips), "train": {"normals": None}}
            done = ("train", "coarse") if code else paper_run._stage_names(wishes)
            scores = {"psnr": 30.0 + job.seed, "ssim": 0.9, "lpips_vgg_3dgs": None, "gaussians": 7}
            result |= {name: scores for name in done if name != "train"}
            if code != 137:  # that one was killed before anything was written
                job.out.mkdir(parents=True)
                (job.out / "result.json").write_text(json.dumps(result))
            return code

        def run(self, *assignments, lpips=(), seeds=1, schedules=("paper_6k_15k",)):
            self.started = []
            options = module.Options(assignments, (), lpips)
            return module.reproduce(
                tmp_path / "data", self.out, schedules=schedules, seeds=seeds, options=options, start=self.start
            )

    return Study()


def test_a_failed_run_is_one_line_and_a_dash_and_the_others_go_on(study, capsys):
    study.codes = {"room": 137}
    failed = study.run()
    assert [job.scene for job in failed] == ["room"]
    assert [scene for scene, _, _ in study.started] == ["room", "kitchen"]
    lines = [line for line in capsys.readouterr().err.splitlines() if "failed" in line]
    assert lines == ["reproduce: room, paper_6k_15k, seed 0: failed (exit code 137)"]
    table = (study.out / "tables.md").read_text()
    room = table[table.index("### room") :]
    assert room.splitlines()[4] == "| gsjax paper_6k_15k, Gaussians | - | - | - | - | 0 of 1 | - | - |"
    assert "| 1 of 4 (kitchen) | 1 | measured |" in table


def test_finished_runs_are_not_done_again_and_more_may_be_asked(study):
    study.run()
    study.run()
    assert study.started == []
    study.run(seeds=2)
    assert study.started == [("room", "paper_6k_15k", 1), ("kitchen", "paper_6k_15k", 1)]
    study.run(schedules=("vanilla",))
    assert study.started == [("room", "vanilla", 0), ("kitchen", "vanilla", 0)]
    table = (study.out / "tables.md").read_text()
    assert "30.50 ± 0.71" in table and "gsjax vanilla, Gaussians" in table and "vanilla, refined" not in table
    with pytest.raises(InputError, match=r"was begun with another settings\.model"):
        study.run("model.sh_degree=1", seeds=3)
    assert study.started == []


@pytest.mark.long
def test_a_protocol_on_a_tiny_scene_makes_its_tables(scripts, tmp_path):
    built_in(tmp_path / "data/tandt/truck", num_views=9, size=(48, 40))
    out, script = tmp_path / "out", Path(scripts("reproduce").__file__)
    run = out / "truck/paper_6k_15k_0"
    command = [sys.executable, str(script), "--data", str(tmp_path / "data"), "--out", str(out)]
    command += ["--preset", "paper_6k_15k", "--set", *SETTINGS, "--refine", *REFINEMENT]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    result = json_files.read(run / "result.json")
    assert scripts("paper_run").is_finished(result)
    table = (out / "tables.md").read_text()
    for kind, name in (("coarse", "Gaussians"), ("refined", "refined")):
        row = re.search(rf"### truck\n[^#]*\| gsjax paper_6k_15k, {name} \[\d\] \| (\d+\.\d\d) .* measured \|", table)
        assert row and float(row[1]) == pytest.approx(result[kind]["psnr"], abs=0.006) and float(row[1]) > 10
    assert "own smoothed normals" in table
    textured = read_textured(run / "textured.glb")
    assert textured is not None and textured.mesh.num_faces == read_mesh(run / "run/mesh.ply").num_faces > 100
    width, height = image_size(run / "sheet.png")
    assert width > height > 300, "two rows of four"
