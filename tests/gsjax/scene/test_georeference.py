"""A placed world: what it does to poses and points, what files say of it, and what a loaded data set makes of it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from meshes import tetrahedron
from photographed_wall import wall, write_wall
from scipy.spatial.transform import Rotation
from small_scenes import cloud
from tolerances import assert_close

from gsjax.errors import InputError
from gsjax.io.gaussian_files import load_gaussians, save_gaussians
from gsjax.io.georeference_files import FILE, read_place, stated_place, write_place
from gsjax.io.scenes import load_scene
from gsjax.meshing.export import read_mesh, write_mesh
from gsjax.scene.georeference import Place, parse_length, parse_place, turn_upright, up_of_cameras

TURN = Rotation.from_rotvec([0.3, -0.2, 1.1]).as_matrix()
PLACE = Place(
    "GPS of 40 photos",
    (0.0, 0.0, 1.0),
    (-33.45123456789, -70.66, 570.5),
    2.5,
    tuple(map(tuple, TURN.tolist())),
    (1.0, -2.0, 0.25),
)


def test_points_and_cameras_move_together():
    rng = np.random.default_rng(0)
    points, viewmat = rng.normal(size=(20, 3)), np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = Rotation.random(random_state=1).as_matrix(), [0.1, 0.2, 3.0]
    camera_points = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    placed = PLACE.viewmat_to_world(viewmat)
    again = PLACE.points_to_world(points) @ placed[:3, :3].T + placed[:3, 3]
    assert_close(again, 2.5 * camera_points)  # the same picture, in metres
    assert_close(placed[:3, :3] @ placed[:3, :3].T, np.eye(3))


def test_a_record_is_the_place_to_the_last_digit_and_a_statement_is_it_of_files_in_the_world():
    record = json.loads(json.dumps(PLACE.record()))
    assert parse_place(record, "here") == PLACE
    assert parse_place(json.loads(json.dumps(PLACE.statement())), "here") == PLACE.reached
    assert not PLACE.reached.moves


@pytest.mark.parametrize(
    "damage",
    [
        {"unit": "foot"},
        {"known_by": None, "up": "north"},
        {"from_files": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}},
    ],
)
def test_a_damaged_record_is_one_line(tmp_path, damage):
    (tmp_path / FILE).write_text(json.dumps({**PLACE.record(), **damage}))
    with pytest.raises(InputError, match="states no place of a scene"):
        read_place(tmp_path)


@pytest.mark.parametrize("name", ["g.ply", "g.compressed.ply", "g.spz", "m.ply", "m.glb", "m.obj"])
def test_files_of_gaussians_and_meshes_state_their_place(tmp_path, name):
    def write(*place):
        if name.startswith("g"):
            save_gaussians(replace(cloud(9), pixel_filter="mip"), tmp_path / name, *place)
            assert load_gaussians(tmp_path / name).pixel_filter == "mip"
        else:
            write_mesh(tmp_path / name, tetrahedron(), *place)
            assert_close(read_mesh(tmp_path / name).vertices, tetrahedron().vertices)

    write(PLACE)
    assert stated_place(tmp_path / name) == PLACE.reached
    write()
    assert not stated_place(tmp_path / name).is_known


def test_a_data_set_is_loaded_in_its_world(tmp_path):
    root = write_wall(wall(4, num_points=30), tmp_path)
    plain = load_scene(root)
    write_place(root, PLACE)
    placed = load_scene(root)
    points = plain.similarity.points_to_world(plain.points)
    assert_close(
        placed.similarity.points_to_world(placed.points),
        PLACE.points_to_world(points),
        atol=1e-5,
        rtol=0,
        why="float32",
    )
    for before, after in zip(plain.frames, placed.frames, strict=True):
        expected = PLACE.viewmat_to_world(plain.similarity.viewmat_to_world(before.viewmat))
        assert_close(placed.similarity.viewmat_to_world(after.viewmat), expected, atol=1e-5, rtol=0, why="float32")
    assert placed.place == PLACE


def test_up_is_where_the_right_vectors_of_level_cameras_are_not():
    rng, up, viewmats = np.random.default_rng(0), TURN @ [0, 0, 1.0], []
    for _ in range(30):
        forward = rng.normal(size=3) * [1, 1, 0.4]
        right = np.cross(forward, [0, 0, 1.0])
        axes = np.stack([right, np.cross(forward, right), forward])
        viewmats.append(np.c_[axes / np.linalg.norm(axes, axis=1, keepdims=True) @ TURN.T, np.zeros(3)])
    direction, error = up_of_cameras(np.stack(viewmats))
    assert_close(direction, up)
    assert error < 1e-7
    _, error = up_of_cameras(np.stack(viewmats[:1] * 5))
    assert error == np.inf
    assert_close(turn_upright(-up) @ -up, np.array([0, 0, 1.0]))


@pytest.mark.parametrize(
    ("text", "metres"),
    [("1.25m", 1.25), ("80cm", 0.8), ("35 mm", 0.035), ("2km", 2000.0), ("10in", 0.254), ("3ft", 0.9144)],
)
def test_a_length_is_in_metres(text, metres):
    assert parse_length(text) == pytest.approx(metres)
