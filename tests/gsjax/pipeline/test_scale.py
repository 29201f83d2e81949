"""Distances between what two pixels show, and the unit that a known one gives to a data set or a run."""

import importlib
import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from meshes import mesh_of
from photographed_wall import FOCAL, wall, write_wall
from run_folders import write_run
from small_scenes import camera_at, plane
from tolerances import assert_close

from gsjax.errors import InputError
from gsjax.io import files, json_files
from gsjax.io.gaussian_files import load_gaussians
from gsjax.io.georeference_files import read_place, stated_place
from gsjax.io.scenes import load_scene
from gsjax.meshing.export import read_mesh, write_mesh
from gsjax.pipeline import scale
from gsjax.runs.pixel_to_point import Pixel
from gsjax.runs.result import open_result

scaling = importlib.import_module("gsjax.pipeline.scale")  # The package's attribute of that name is the function.
WALL = wall(6, num_points=3000)
SPOTS = Pixel("00.png", 20.0, 30.0), Pixel("00.png", 60.0, 30.0)
TRUE = 40 * 3 / FOCAL  # of the wall, which is 3 away


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """The wall on disk; its tracks, which its files do not keep, in memory."""
    root = write_wall(WALL, tmp_path / "scene")
    monkeypatch.setattr(scaling, "load_scene", lambda source: replace(WALL, root=root))
    return root


@pytest.fixture
def run(tmp_path):
    """A wall of Gaussians, 4 away from its two cameras."""
    cameras = [camera_at((x, 0.0, 0.0), (x, 0.0, 4.0), size=(48, 40)) for x in (-0.2, 0.3)]
    folder = write_run(tmp_path / "run", plane((0.0, 0.0, -1.0)), cameras)
    json_files.write(folder / "manifest.json", {"scene": "gone", "status": "done"})
    json_files.write(folder / "plan.json", {"phases": [], "steps": 1, "downscale": 2.0})
    write_mesh(folder / "mesh.ply", mesh_of(np.eye(3), [[0, 1, 2]]))
    return folder


def test_a_scene_of_a_known_length_is_in_metres_and_upright(scene):
    assert scale(scene, SPOTS, 6.0)["factor"] == pytest.approx(6.0 / TRUE, rel=1e-4)
    place = read_place(scene)
    assert place.known_by == "6 m between 00.png 20 30 and 00.png 60 30"
    placed, plain = load_scene(scene), WALL
    after, before = placed.similarity.points_to_world(placed.points), plain.points.astype(np.float64)
    assert_close(np.ptp(after[:, 0]), 6.0 / TRUE * np.ptp(before[:, 0]), rtol=1e-4, atol=0, why="float32 poses")
    # Cameras look along z with y down: up is -y, and becomes z.
    assert_close(after[:, 2], -6.0 / TRUE * before[:, 1], rtol=0, atol=1e-3, why="float32 poses")


def test_a_run_of_a_known_length_has_files_in_metres_and_computes_what_it_did(run):
    pixels = Pixel("0.jpg", 2 * 12.0, 2 * 20.0), Pixel("0.jpg", 2 * 36.0, 2 * 20.0)  # of photos twice the size
    true = 24 * 4 / 30
    report = scale(run, pixels, 2.0)
    assert report["distance"] == pytest.approx(true, rel=0.02)  # Gaussians have some thickness.
    before, gaussians, factor = plane((0.0, 0.0, -1.0)), load_gaussians(run), report["factor"]
    assert_close(gaussians.means, factor * np.asarray(before.means))
    assert_close(np.exp(gaussians.log_scales), factor * np.exp(before.log_scales))
    assert_close(read_mesh(run / "mesh.ply").vertices, factor * np.eye(3, dtype=np.float32))
    for file in ("gaussians.ply", "mesh.ply"):
        assert stated_place(run / file) == read_place(run).reached and read_place(run).is_known
    result = open_result(run)
    assert_close(result.gaussians.means, np.asarray(before.means))
    assert_close(result.cameras[1].viewmat, np.asarray(camera_at((0.3, 0.0, 0.0), (0.3, 0.0, 4.0)).viewmat))
    again = scale(run, pixels)
    assert (again["unit"], again["distance"]) == ("metre", pytest.approx(2.0, rel=1e-5))


@pytest.mark.parametrize("renamed", range(7))
def test_the_files_of_a_run_are_all_old_or_all_new_wherever_it_is_stopped(run, renamed, monkeypatch):
    pixels = Pixel("0.jpg", 24.0, 40.0), Pixel("0.jpg", 72.0, 40.0)
    replace_file, left = os.replace, [renamed]

    def killed(old, new):
        if Path(old).parent.name == files.PENDING or Path(new).name == files.PENDING:
            left[0] -= 1
            if left[0] < 0:
                raise ZeroDivisionError  # No OSError, which would be told.
        replace_file(old, new)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", killed)
        with suppress(ZeroDivisionError):
            scale(run, pixels, 2.0)
    result = open_result(run)
    unit = 1 if renamed == 0 else result.similarity.scale
    assert (unit == 1) == (renamed == 0)  # The first renaming decides.
    assert_close(unit * np.asarray(load_gaussians(run).means), np.asarray(plane((0.0, 0.0, -1.0)).means))
    assert_close(unit * read_mesh(run / "mesh.ply").vertices, np.eye(3, dtype=np.float32))
    before = {file: file.read_bytes() for file in run.iterdir() if file.suffix}
    again = scale(run, pixels, 2.0)
    assert (again["factor"] is None) == (unit != 1)
    assert unit == 1 or before == {file: file.read_bytes() for file in before}


@pytest.mark.parametrize(
    ("pixel", "message"),
    [
        (Pixel("7.jpg", 1.0, 1.0), "has no photo 7.jpg; one is called 0.jpg"),
        (Pixel("0.jpg", 96.5, 1.0), "0.jpg 96.5 1: is outside the photo, which is 96x80"),
        (Pixel("0.jpg", 48.0, 40.0), "show one point"),
    ],
)
def test_what_cannot_be_measured_in_a_run_is_one_line_and_changes_nothing(run, pixel, message):
    before = {file: file.read_bytes() for file in run.rglob("*") if file.is_file()}
    with pytest.raises(InputError, match=message):
        scale(run, (Pixel("0.jpg", 48.0, 40.0), pixel), 1.0)
    assert before == {file: file.read_bytes() for file in before}


def test_where_nothing_was_triangulated_there_is_no_length(scene, monkeypatch):
    empty = replace(wall(6, num_points=4), root=scene)
    monkeypatch.setattr(scaling, "load_scene", lambda source: empty)
    with pytest.raises(InputError, match="no triangulated point is seen (within 4 pixels|in 00.png)"):
        scale(scene, SPOTS, 1.0)
    monkeypatch.setattr(scaling, "load_scene", lambda source: replace(empty, tracks=None))
    with pytest.raises(InputError, match="holds no triangulated points that photos see"):
        scale(scene, SPOTS, 1.0)
