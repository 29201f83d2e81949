"""The whole road on a small scene: trained, stopped and continued, refused."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from trained_run import MASK, SETTINGS, train_until_killed

from gsjax import cli, config, pipeline, runs
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.images import read_image, read_mask, write_image
from gsjax.io.ply import read_gaussians
from gsjax.planning import preparation, sparse_view_validation, sparse_views
from gsjax.planning.sparse_views import Gain


def first_state_of(scene, folder, settings, **how):
    """The state that a training begins with; the loop takes no step."""
    states = []

    def follow(work, state, capacity):
        states.append(state)
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setitem(pipeline.train.__globals__, "follow", follow)
        pipeline.train(scene, folder, settings, **how)
    return states[0]


def test_a_run_folder_holds_what_was_asked_and_what_came_of_it(run, scene):
    manifest = json_files.read(run / "manifest.json")
    assert manifest["status"] == "done"
    assert Path(manifest["scene"]) == scene.resolve()
    assert {"config.json", "metrics.jsonl", "gaussians.ply", "cameras.json", "normals/001.png"} <= set(
        manifest["files"]
    )
    masks = [record["mask"] for record in json_files.read(run / "cameras.json")]
    assert [path for path in masks if path] == [masks[3]] == ["masks/0003.png"]
    np.testing.assert_array_equal(read_mask(run / masks[3]), MASK)
    steps = [record["step"] for record in runs.read_metrics(run)]
    assert steps == [5, 10, 15, 20, 25, 30]
    assert runs.read_metrics(run)[2]["held_out_psnr"] > 5
    compiled = [one["program"] for record in runs.read_metrics(run) for one in record.get("compiled", [])]
    assert compiled.count("train_step") == 3, "one program a phase"
    gaussians = read_gaussians(run / "gaussians.ply")
    assert gaussians.num_gaussians == manifest["gaussians"] <= SETTINGS["model"]["max_gaussians"]
    assert manifest["photos"] == "9 photos at 48x40, 30 steps"


def test_a_report_is_left_and_a_run_that_kept_no_pictures_is_rendered_for_it(run, scene, tmp_path):
    pictures = {file.name: read_image(file)[0].astype(float) for file in (run / "pictures").iterdir()}
    photo, other = (read_image(scene / "images" / name)[0] for name in ("000.png", "008.png"))
    # JPEG leaves 5 of 255 in a picture of 48 pixels; the other view is far from that.
    assert np.abs(pictures["0000_photo.jpg"] - photo).mean() < 8 < np.abs(pictures["0000_photo.jpg"] - other).mean() / 3
    assert (run / "report.html").read_text().count("data:image/jpeg") == len(pictures) == 6

    shutil.copytree(run, tmp_path / "run", ignore=shutil.ignore_patterns("pictures"))
    pipeline.report(tmp_path / "run")
    for name, image in pictures.items():
        assert np.abs(read_image(tmp_path / "run/pictures" / name)[0] - image).mean() < 1, name


def test_a_run_that_is_killed_goes_on_to_the_same_bits(run, scene, tmp_path):
    """From checkpoints of every seventh step and of each phase's end, of which two are kept.

    A schedule takes a term out of the preset that it changes by a weight of zero, which is no other setting.
    """
    phases = [
        {**phase, "weights": {"sdf_normal": 0.0, **phase.get("weights", {})}}
        for phase in SETTINGS["schedule"]["phases"]
    ]
    settings = config.merge(SETTINGS, {"schedule": {"phases": phases}})
    folder = tmp_path / "run"
    train_until_killed(23, scene, folder, settings)
    assert sorted(file.name for file in (folder / "checkpoints").iterdir()) == ["step_0000020.npz", "step_0000021.npz"]
    pipeline.train(scene, folder, settings, resume=True)

    assert (folder / "gaussians.ply").read_bytes() == (run / "gaussians.ply").read_bytes()
    for file in (run / "normals").iterdir():
        assert (folder / "normals" / file.name).read_bytes() == file.read_bytes()
    without_time = [
        [{k: v for k, v in record.items() if k not in ("seconds", "compiled")} for record in runs.read_metrics(one)]
        for one in (folder, run)
    ]
    assert without_time[0] == without_time[1]


def test_with_little_memory_photos_lie_on_the_disk_and_the_bits_are_the_same(run, scene, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("gsjax.planning.memory.free_memory", lambda: 0)
    pipeline.train(scene, tmp_path / "run", SETTINGS)
    assert (tmp_path / "run/gaussians.ply").read_bytes() == (run / "gaussians.ply").read_bytes()
    assert "each step reads its photo from the disk" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]


def test_points_are_looked_for_before_the_first_step_and_never_again(run, scene, tmp_path, monkeypatch, capsys):
    capacities = []

    def far_away(scene, planned, swept):
        capacities.append(planned.max_gaussians)
        return replace(scene, points=scene.points + np.float32(100)), ("found some",)

    monkeypatch.setattr(preparation, "with_stereo_points", far_away)
    state = first_state_of(scene, tmp_path / "begun", SETTINGS)
    assert capacities == [900] and "train: found some\n" in capsys.readouterr().err
    assert np.median(state.gaussians.alive().means) > 90
    shutil.copytree(run, tmp_path / "run")
    first_state_of(scene, tmp_path / "run", SETTINGS, resume=True)
    first_state_of(scene, tmp_path / "other", SETTINGS, warm_start=run)
    assert capacities == [900] and "found some" not in capsys.readouterr().err
    json_files.write(tmp_path / "run/config.json", {"model": {"cloud": 3}})  # of an earlier version
    with pytest.raises(InputError, match=r"run/config\.json: unknown key 'model\.cloud'"):
        pipeline.train(scene, tmp_path / "run", SETTINGS, resume=True)


def test_sparse_view_validation_runs_are_made_once_and_a_run_goes_on_as_they_said(scene, tmp_path, monkeypatch, capsys):
    folds, run = [], tmp_path / "run"

    def helps(scene, settings, held_back):
        folds.append([frame.name for frame in scene.train_frames])
        return Gain(0.5, 0.1)

    monkeypatch.setattr(sparse_view_validation, "gain", helps)
    monkeypatch.setattr(sparse_views, "SHORTEST", 12)
    first = SETTINGS["schedule"]["phases"][:1]
    settings = config.merge(SETTINGS, {"schedule": {"sparse_views": True, "phases": first}})
    for how in ({}, {"resume": True}):
        first_state_of(scene, run, settings, **how)
        line = "with 450 Gaussians, of which each step leaves out 20% (validation runs: +0.5 +-0.1 dB)"
        assert line in capsys.readouterr().err
        plan = json_files.read(run / "plan.json")
        assert (plan["max_gaussians"], [phase["dropout"] for phase in plan["phases"]]) == (450, [0.2])
    assert len(folds) == 1


def test_a_run_that_begins_in_another_ends_with_the_same_bits(run, first_phase, scene, tmp_path):
    first_run, whole = shutil.copytree(first_phase[0], tmp_path / "begun"), tmp_path / "whole"
    pipeline.train(scene, whole, SETTINGS, warm_start=first_run)
    assert (whole / "gaussians.ply").read_bytes() == (run / "gaussians.ply").read_bytes()
    assert [record["step"] for record in runs.read_metrics(whole)] == [5, 10, 12, 15, 20, 25, 30]

    plan = json_files.read(run / "plan.json")
    plan["phases"][1]["terms"]["entropy"] = 0.2  # So they part after 12 steps, and later checkpoints will not do.
    json_files.write(first_run / "plan.json", plan)
    early = list((first_run / "checkpoints").iterdir())
    for later in (run / "checkpoints").iterdir():
        shutil.copy(later, first_run / "checkpoints")
    assert first_state_of(scene, tmp_path / "parted", SETTINGS, warm_start=first_run).step == 12
    for file in early:
        file.unlink()
    with pytest.raises(InputError, match="begun: has no checkpoint of the 12 steps that this run has in common"):
        pipeline.train(scene, tmp_path / "none", SETTINGS, warm_start=first_run)
    assert not (tmp_path / "none").exists()


@pytest.mark.long
def test_a_run_that_holds_nothing_out_is_meshed_and_measured_but_not_scored(scene, tmp_path):
    """On the photos that the other runs train on: their programs, compiled once."""
    model = pycolmap.Reconstruction(scene / "sparse/0")
    for image in [image for image in model.images.values() if image.name in ("000.png", "008.png")]:
        model.deregister_frame(image.frame_id)
    (tmp_path / "scene/sparse/0").mkdir(parents=True)
    model.write_binary(tmp_path / "scene/sparse/0")
    shutil.copy(scene / "gt_points.npz", tmp_path / "scene")
    photos = {"hold_out": "none", "images": str(scene / "images")}
    settings = config.merge(SETTINGS, {"photos": photos})
    summary = pipeline.train(tmp_path / "scene", tmp_path / "run", settings)
    assert (summary["psnr"], summary["ssim"], summary["views"], summary["steps"]) == (None, None, 0, 30)
    assert not any(camera["held_out"] for camera in json_files.read(tmp_path / "run/cameras.json"))
    assert not any("held_out_psnr" in record for record in runs.read_metrics(tmp_path / "run"))
    figures = pipeline.evaluate(tmp_path / "run", mesh=scene / "gt_mesh.ply")
    assert (figures["psnr"], figures["views"]) == (None, 0)
    assert figures["chamfer"] < 0.025, "the true mesh: 0.021, as its samples lie apart"
    with pytest.raises(InputError, match="run: has no held-out views to render"):
        pipeline.render(tmp_path / "run", tmp_path / "pictures", views="held_out")


def test_data_that_do_not_fit_are_one_line_and_leave_no_run(scene, tmp_path, capsys):
    for index in range(9):
        write_image(tmp_path / f"maps/{index:03d}.png", np.full((40, 40, 3), 9, np.uint8))
    options = ["--normals", str(tmp_path / "maps"), "--set", "schedule.sparse_views=false"]  # No validation first.
    assert cli.main(["train", str(scene), "--out", str(tmp_path / "run"), *options]) == 2
    *progress, error = capsys.readouterr().err.splitlines()
    assert error.startswith("gsjax: error: ") and "maps/001.png: normal map is 40x40, its frame 48x40" in error
    assert not any("Error" in line for line in progress)
    assert not (tmp_path / "run").exists()
