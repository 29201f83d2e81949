"""What is planted about a known scene is found, by its kind; nothing of the scene is lost; and it can come back."""

import jax
import numpy as np
import pytest
from run_folders import write_run
from small_scenes import camera_at, discs
from tolerances import assert_close

from gsjax.errors import InputError
from gsjax.gaussians import concatenate, take
from gsjax.io import json_files
from gsjax.io.gaussian_files import load_gaussians
from gsjax.io.ply import write_gaussians
from gsjax.pipeline.clean import clean, undo

RADIUS, RING = 1.0, 4.0
EYES = [RING * np.array([np.cos(a), np.sin(a), 0.2]) for a in 2 * np.pi * np.arange(6) / 6]


def cluster(middle, count=4):
    """A few discs close together that face nobody in particular."""
    rng = np.random.default_rng(abs(int(1000 * sum(middle))))
    return discs(np.asarray(middle) + 0.03 * rng.normal(size=(count, 3)), np.tile([0.0, 0, 1], (count, 1)), 0.05)


def planted():
    """A ball, isolated clusters in front of and above it, and giants; with the kind of every row."""
    index = np.arange(900)
    height, angle = 1 - 2 * (index + 0.5) / 900, np.pi * (3 - np.sqrt(5)) * index
    ring = np.sqrt(1 - height**2)
    points = RADIUS * np.stack([ring * np.cos(angle), ring * np.sin(angle), height], -1)
    ball = discs(points, points, 0.08)
    isolated = [cluster(middle) for middle in (*(0.5 * eye for eye in EYES[:3]), (0.0, 0.0, 1.4), (0.2, 0.1, -1.7))]
    giants = discs(np.array([[1.5, 2.0, 0], [0, 0, 3.0]]), np.array([[0.0, 0, 1], [0, 0, 1]]), 4.0, opacity=0.02)
    parts = [ball, *isolated, giants]
    kinds = ["scene"] + ["isolated"] * len(isolated) + ["giants"]
    rows = np.repeat(kinds, [part.num_gaussians for part in parts])
    order = np.random.default_rng(0).permutation(len(rows))
    return jax.tree.map(np.asarray, take(concatenate(parts), order)), rows[order]


@pytest.fixture
def run(tmp_path):
    """A run of what is planted, seen from six sides."""
    cameras = [camera_at(eye, (0.0, 0.0, 0.0), size=(48, 40), focal=50.0) for eye in EYES]
    json_files.write(tmp_path / "manifest.json", {"scene": "gone", "status": "done"})
    return write_run(tmp_path, planted()[0], cameras)


def test_planted_dirt_is_found_by_its_kind_nothing_else_is_and_all_of_it_comes_back(run):
    gaussians, kinds = planted()
    file = run / "gaussians.ply"
    before = file.read_bytes()
    report = clean(run)
    assert {kind: report[kind] for kind in ("isolated", "giants", "cropped")} == {
        "isolated": (kinds == "isolated").sum(),
        "giants": (kinds == "giants").sum(),
        "cropped": 0,
    }
    assert_close(load_gaussians(file).means, np.asarray(gaussians.means)[kinds == "scene"])
    assert (run / "gaussians.ply.cleaned.png").stat().st_size > 1000
    with pytest.raises(InputError, match="was cleaned before; `gsjax clean .* --undo` restores"):
        clean(run)
    assert undo(run) == {"gaussians": len(kinds), "back": int((kinds != "scene").sum())}
    assert file.read_bytes() == before
    with pytest.raises(InputError, match="nothing was taken out of it"):
        undo(run)


def test_a_cleaning_that_was_stopped_is_done_again_or_undone_but_not_on_another_file(run):
    file, whole = run / "gaussians.ply", (run / "gaussians.ply").read_bytes()
    clean(run)
    cleaned = file.read_bytes()
    file.write_bytes(whole)  # Stopped before the file was written.
    clean(run)
    assert file.read_bytes() == cleaned
    file.write_bytes(whole)
    assert undo(run)["back"] == 0
    assert file.read_bytes() == whole and not list(run.glob("*.original.*"))
    clean(run)
    write_gaussians(file, take(planted()[0], slice(None, None, -1)))
    with pytest.raises(InputError, match="is not the file any more that"):
        undo(run)


def test_a_file_without_cameras_loses_what_hangs_on_nothing_and_lies_outside_a_crop(tmp_path):
    gaussians, kinds = planted()
    bare, out, means = tmp_path / "bare.ply", tmp_path / "clean.ply", np.asarray(gaussians.means)
    write_gaussians(bare, gaussians)
    report = clean(bare, out)
    assert (report["isolated"], report["giants"]) == ((kinds == "isolated").sum(), 2)
    assert load_gaussians(bare).num_gaussians == len(kinds)
    assert load_gaussians(out).num_gaussians == (kinds == "scene").sum()
    assert report["picture"] is None
    clean(bare, tmp_path / "half.ply", box=(-9, -9, 0, 9, 9, 9))
    assert (load_gaussians(tmp_path / "half.ply").means[:, 2] >= 0).all()
    report = clean(bare, tmp_path / "cap.ply", sphere=(0, 0, 1, 0.25))
    inside = np.linalg.norm(means - [0, 0, 1], axis=1) <= 0.25
    assert_close(load_gaussians(tmp_path / "cap.ply").means, means[inside])
    assert report["cropped"] == (~inside).sum() - report["isolated"] - report["giants"]
    for wrong, message in (
        ({"sphere": (9, 9, 9, 1)}, "none of its .* would be left"),
        ({"box": (1, 0, 0, 0, 1, 1)}, "box 1"),
        ({"crop_to_cameras": True}, "comes without cameras, and a crop to cameras needs"),
    ):
        with pytest.raises(InputError, match=message):
            clean(bare, tmp_path / "none.ply", **wrong)
    assert not (tmp_path / "none.ply").exists()
