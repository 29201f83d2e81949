"""The order of the stages, what is not done twice, what is refused; the stages themselves have tests of their own."""

import importlib
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from gsjax import cli
from gsjax.binding.refinement import Refinement
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.locks import lock_folder
from gsjax.pipeline.scan import scan, table
from gsjax.settings import Settings

scanning = importlib.import_module("gsjax.pipeline.scan")  # The package's attribute of that name is the function.


@dataclass(frozen=True)
class SfmReport:
    registered: int = 7
    left_out: dict[str, str] = field(default_factory=dict)
    passed_over: dict[str, str] = field(default_factory=dict)
    images: int = 15


@pytest.fixture
def stages(monkeypatch):
    """Stages that write what the real ones leave, and note how they were called; `fail` names one that breaks."""
    calls, broken = [], set()

    def stage(name, make):
        def run(*arguments, **options):
            calls.append((name, *(str(a) for a in arguments if isinstance(a, str | Path)), options))
            if name in broken:
                raise InputError(f"{name} has no room")
            return make(*arguments)

        return run

    def run_folder(*arguments):
        arguments[1].mkdir(parents=True, exist_ok=True)
        json_files.write(arguments[1] / "manifest.json", {"status": "done"})
        return {"psnr": 30.0}

    def product(*arguments):
        arguments[-1].parent.mkdir(parents=True, exist_ok=True)
        arguments[-1].write_bytes(b"whole")
        return {"faces": 12}

    def scene(source, folder):
        folder.mkdir()
        return SfmReport()

    import gsjax.io.sfm

    monkeypatch.setattr(gsjax.io.sfm, "reconstruct", stage("sfm", scene))
    monkeypatch.setattr(scanning, "train", stage("train", run_folder))
    monkeypatch.setattr(scanning, "mesh", stage("mesh", product))
    monkeypatch.setattr(scanning, "refine", stage("refine", run_folder))
    monkeypatch.setattr(scanning, "texture", stage("texture", product))
    monkeypatch.setattr(scanning, "_overview", lambda out: out / "overview.png")
    monkeypatch.setattr(scanning, "write_report", lambda out: (out / "report.html").write_text("whole"))
    return calls, broken


@pytest.fixture
def photos(tmp_path):
    (tmp_path / "photos").mkdir()
    return tmp_path / "photos"


def scanned(source, out, settings=None, **options):
    return scan(source, out, settings or Settings(), Refinement(), progress=lambda line: None, **options)


def test_every_stage_leaves_its_work_where_its_command_would(stages, photos, tmp_path):
    out = tmp_path / "scan"
    report = scanned(photos, out, frames=30, terms={"flat": len}, method=max)
    calls, _ = stages
    assert [(name, *(str(Path(p).relative_to(tmp_path)) for p in paths)) for name, *paths, _ in calls] == [
        ("sfm", "photos", "scan/scene"),
        ("train", "scan/scene", "scan/run"),
        ("mesh", "scan/run", "scan/run/mesh.ply"),
        ("refine", "scan/run", "scan/refined"),
        ("texture", "scan/refined", "scan/refined/mesh.ply", "scan/mesh.glb"),
    ]
    assert calls[0][-1] == {"frames": 30} and calls[2][-1] == {"method": max}
    pieces = {"terms": {"flat": len}, "densification": None, "effects": {}}
    assert calls[1][-1] == {"settings": Settings(), **pieces, "resume": False}
    assert (report["asked"]["handed_in"]["terms"], report["asked"]["method"]) == (["flat"], "max")
    assert json_files.read(out / "report.json") == json_files.plain(report)
    assert (out / "report.html").exists()
    rows = table(report)
    assert list(rows) == ["sfm", "train", "mesh", "refine", "texture"]
    assert rows["sfm"]["registered"] == 7 and rows["mesh"]["faces"] == 12
    assert all(row["seconds"] >= 0 and row["peak_gib"] > 0 for row in rows.values())


def test_a_scan_goes_on_where_it_stopped_and_then_has_nothing_to_do(stages, photos, tmp_path):
    """As it began it was killed, and had written nothing whole; two at a time do not work in its folder."""
    calls, broken = stages
    broken.add("refine")
    (tmp_path / "scan").mkdir()
    (tmp_path / "scan/.lock").write_text("")
    (tmp_path / "scan/.report.gsjax-1-0123abcd.json").write_text("{")
    with lock_folder(tmp_path / "scan"), pytest.raises(InputError, match="scan: another process is at work"):
        scanned(photos, tmp_path / "scan")
    with pytest.raises(InputError, match="refine has no room"):
        scanned(photos, tmp_path / "scan")
    (tmp_path / "scan/refined").mkdir()  # as a refinement that was killed leaves it
    broken.clear()
    calls.clear()
    report = scanned(photos, tmp_path / "scan")
    assert [call[0] for call in calls] == ["refine", "texture"]
    assert calls[0][-1] == {"settings": Refinement(), "resume": True}
    assert list(report["stages"]) == ["sfm", "train", "mesh", "refine", "texture"], "what was done before is told too"
    calls.clear()
    scanned(photos, tmp_path / "scan")
    assert calls == []


def test_a_data_set_with_poses_is_not_reconstructed(stages, tmp_path):
    scene = tmp_path / "scene"
    (scene / "sparse/0").mkdir(parents=True)
    (scene / "sparse/0/cameras.bin").write_bytes(b"")
    with pytest.raises(InputError, match="scene: is a data set.* frames and mask_below: for photos or a video"):
        scanned(scene, tmp_path / "scan", frames=30, mask_below=60.0)
    assert not (tmp_path / "scan").exists()
    scanned(scene, tmp_path / "scan")
    calls, _ = stages
    assert calls[0][:2] == ("train", str(scene))


def test_a_folder_with_other_things_or_other_wishes_is_left_alone(stages, photos, tmp_path):
    _, broken = stages
    broken.add("sfm")
    with pytest.raises(InputError, match="sfm has no room"):
        scanned(photos, tmp_path / "scan", Settings(seed=1))  # It leaves no wishes that others could contradict.
    assert not (tmp_path / "scan").exists()
    broken.clear()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/letter.txt").write_text("kept")
    with pytest.raises(InputError, match="mine: this folder is not empty and holds no scan"):
        scanned(photos, tmp_path / "mine")
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["letter.txt"]
    scanned(photos, tmp_path / "scan")
    with pytest.raises(InputError, match="scan: was begun with another settings"):
        scanned(photos, tmp_path / "scan", Settings(seed=1))
    with pytest.raises(InputError, match="scan: was begun with another source"):
        scanned(tmp_path, tmp_path / "scan")


def test_photos_are_reconstructed_as_sfm_would_and_a_resumed_scan_is_the_same(
    stages, photos, tmp_path, monkeypatch, capsys
):
    calls, out = stages[0], str(tmp_path / "scan")
    monkeypatch.chdir(tmp_path)
    arguments = ["--panoramas", "--mask-below", "60", "--features", "aliked", "--weights", "a.onnx"]
    assert cli.main(["scan", "photos", "--out", out, *arguments]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("only 7 of 15 photos are in the model")
    options = {"panoramas": True, "mask_below": 60.0, "features": "aliked", "weights": "a.onnx"}
    assert calls[0] == ("sfm", "photos", out + "/scene", options)
    monkeypatch.chdir(photos)
    arguments[-1] = "../a.onnx"
    assert cli.main(["scan", ".", "--out", out, *arguments]) == 0, "the same files, named from elsewhere"
    for other in (arguments[:4], [*arguments[:2], "50", *arguments[3:]], [*arguments[:-1], "b.onnx"]):
        assert cli.main(["scan", ".", "--out", out, *other]) == 2
    assert len(calls) == 5, "none of these did anything"
