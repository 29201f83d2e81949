"""The photos of a run after its data set changed: deleted, added, moved to another folder."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from trained_run import train_until_killed

from gsjax import cli, config, pipeline
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.scenes import load_scene
from gsjax.runs.result import scene_of_run
from gsjax.runs.run import Run

SETTINGS = {
    "model": {"max_gaussians": 300, "sh_degree": 0},
    "photos": {"hold_out": "3"},
    "schedule": {"phases": [{"name": "all", "steps": 6}]},
    "logging": {"metrics_every": 3, "evaluate_every": 6, "checkpoint_every": 3},
}
NAMES = [f"{n:03d}.png" for n in range(9)]


@pytest.fixture
def listed(scene, tmp_path) -> Path:
    """The data set with its photos listed in transforms.json, from which they can be deleted one by one."""
    root = tmp_path / "listed"
    shutil.copytree(scene / "images", root / "images")
    loaded = load_scene(scene)
    frames = [
        {
            "file_path": f"images/{frame.name}",
            "transform_matrix": (np.linalg.inv(frame.viewmat) @ np.diag([1, -1, -1, 1])).tolist(),
        }
        for frame in loaded.frames
    ]
    K, size = loaded.frames[0].K, loaded.frames[0]
    lens = {"w": size.width, "h": size.height, "fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    json_files.write(root / "transforms.json", {**lens, "frames": frames})
    return root


def delete(root, name):
    meta = json_files.read(root / "transforms.json")
    meta["frames"] = [frame for frame in meta["frames"] if frame["file_path"] != f"images/{name}"]
    json_files.write(root / "transforms.json", meta)
    (root / "images" / name).unlink()


def held_out(run):
    return [record["name"] for record in json_files.read(run / "cameras.json") if record["held_out"]]


def test_photos_deleted_before_a_resume_do_not_shift_the_split(listed, tmp_path, capfd):
    run = tmp_path / "run"
    train_until_killed(4, listed, run, SETTINGS)
    for name in (NAMES[1], NAMES[3]):
        delete(listed, name)
    pipeline.train(listed, run, SETTINGS, resume=True)
    assert held_out(run) == [NAMES[0], NAMES[6]]
    assert f"{listed}: lacks photos that {run} was begun with: {NAMES[1]}, {NAMES[3]}\n" in capfd.readouterr().err


def test_with_exposure_of_each_photo_a_trained_photo_must_be_there_and_a_held_out_one_need_not(listed, tmp_path):
    settings, run = config.merge(SETTINGS, {"effects": {"names": "exposure"}}), tmp_path / "run"
    train_until_killed(4, listed, run, settings)
    backup = shutil.copytree(listed, tmp_path / "whole")
    delete(listed, NAMES[2])
    with pytest.raises(InputError) as error:
        pipeline.train(listed, run, settings, resume=True)
    assert str(error.value) == (
        f"{listed}: lacks {NAMES[2]}, which {run} was trained on with exposure of each photo; put it back to resume"
    )
    shutil.rmtree(listed)
    shutil.copytree(backup, listed)
    delete(listed, NAMES[3])
    assert pipeline.train(listed, run, settings, resume=True)["views"] == 2
    assert held_out(run) == [NAMES[0], NAMES[6]]


def test_eval_refuses_a_place_without_the_photos_keeps_the_split_and_names_what_is_gone(listed, tmp_path, capfd):
    run, other = tmp_path / "run", tmp_path / "other"
    pipeline.train(listed, run, SETTINGS)
    shutil.copytree(listed, other)
    meta = json_files.read(other / "transforms.json")
    for frame in meta["frames"]:
        path = other / frame["file_path"]
        frame["file_path"] = f"images/IMG_{path.name}"
        path.rename(other / frame["file_path"])
    json_files.write(other / "transforms.json", meta)
    for command, fault in (
        (["train", "--out", str(run), "--resume", "--scene", str(other)], f"{other}: has none of the "),
        (["eval", str(run), "--scene", str(other)], f"{other}: has none of the "),
        (["train", "--out", "new", "--scene", str(other)], "--scene: is the new place of a run's data set"),
        (["train", "--out", "new"], "SCENE: name the folder of the data set"),
    ):
        assert cli.main(command) == 2
        assert fault in capfd.readouterr().err
    manifest = Run.open(run).manifest
    assert manifest["scene"] == str(listed)

    expected = {"train": [NAMES[n] for n in (1, 2, 4, 5, 7, 8)], "held_out": [NAMES[n] for n in (0, 3, 6)]}
    assert manifest["split"] == expected
    shutil.copy(listed / "images" / NAMES[1], listed / "images/000a.png")
    meta = json_files.read(listed / "transforms.json")
    meta["frames"].append({**meta["frames"][1], "file_path": "images/000a.png"})
    json_files.write(listed / "transforms.json", meta)
    delete(listed, NAMES[0])
    frames = scene_of_run(run).frames
    assert [frame.name for frame in frames if frame.held_out] == [NAMES[3], NAMES[6]]
    lines = capfd.readouterr().err
    assert f"{listed}: lacks photos that {run} was begun with: {NAMES[0]}\n" in lines
    assert f"{listed}: has photos that {run} was begun without, which are left out: 000a.png\n" in lines


def test_a_moved_data_set_is_named_for_eval_and_recorded_by_a_resume(listed, tmp_path, capfd):
    run, place = tmp_path / "run", tmp_path / "elsewhere/set"
    (listed / "mine.txt").write_text(f"{NAMES[2]}\n")
    settings = config.merge(
        SETTINGS, {"photos": {"hold_out": str(listed / "mine.txt"), "images": str(listed / "images")}}
    )
    train_until_killed(4, listed, run, settings)
    place.parent.mkdir()
    shutil.move(listed, place)
    assert cli.main(["train", str(place), "--out", str(run), "--resume"]) == 2
    assert "a resumed run keeps its data set, and --scene " in capfd.readouterr().err
    assert cli.main(["train", "--out", str(run), "--resume", "--scene", str(place)]) == 0
    assert Run.open(run).manifest["scene"] == str(place)
    assert held_out(run) == [NAMES[2]]
    assert json_files.read(run / "config.json")["photos"]["hold_out"] == str(place / "mine.txt")

    again = tmp_path / "again"
    shutil.move(place, again)
    capfd.readouterr()
    assert cli.main(["eval", str(run)]) == 2
    message = (
        f"{run}: its data set is no longer in {place}; `gsjax train --out {run} --resume --scene FOLDER` sets where"
    )
    assert message in capfd.readouterr().err
    assert cli.main(["eval", str(run), "--scene", str(again), "--json", str(tmp_path / "scores.json")]) == 0
    assert json_files.read(tmp_path / "scores.json")["views"] == 1
