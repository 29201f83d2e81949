"""Meshes of a made room, four by three by two and a half metres, against itself."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsjax.errors import InputError
from gsjax.meshing.export import write_mesh
from gsjax.scene.meshes import Mesh

SIZE = np.array([4.0, 3.0, 2.5])
PER_SIDE = 24
NUMBERS = {"TRUTH_POINTS": 2000, "DENSE_TRUTH": 40_000, "MESH_POINTS": 4000, "DENSE_MESH": 40_000, "ROUNDS": 12}
TURN, SHIFT, SCALE = Rotation.from_euler("xyz", [40, -70, 110], degrees=True).as_matrix(), np.array([5.0, -2, 1]), 0.4
"""From the truth's world to that of the run: what the cameras must find out."""


def wall(axis, end):
    """Vertices and faces of one wall of the room, its normals inwards or outwards."""
    u, v = (other for other in range(3) if other != axis)
    steps = np.linspace(0, 1, PER_SIDE + 1)
    vertices = np.zeros(((PER_SIDE + 1) ** 2, 3))
    vertices[:, u], vertices[:, v] = (grid.ravel() for grid in np.meshgrid(steps * SIZE[u], steps * SIZE[v]))
    vertices[:, axis] = end * SIZE[axis]
    corner = np.add.outer(np.arange(PER_SIDE) * (PER_SIDE + 1), np.arange(PER_SIDE)).ravel()
    right, below = corner + 1, corner + PER_SIDE + 1
    return vertices, np.concatenate([np.stack([corner, right, below], -1), np.stack([right, below + 1, below], -1)])


def room(without=()):
    vertices, faces = [], []
    for index, (axis, end) in enumerate((axis, end) for axis in range(3) for end in (0, 1)):
        if index not in without:
            of_wall, triangles = wall(axis, end)
            faces.append(triangles + sum(map(len, vertices)))
            vertices.append(of_wall)
    vertices = np.concatenate(vertices)
    return Mesh(vertices.astype(np.float32), np.concatenate(faces).astype(np.int32), np.zeros(vertices.shape, np.uint8))


def save(mesh, file, *, in_run=True):
    vertices = SCALE * mesh.vertices @ TURN.T + SHIFT if in_run else mesh.vertices
    write_mesh(file, Mesh(vertices.astype(np.float32), mesh.faces, mesh.colors))


@pytest.fixture
def script(scripts, monkeypatch, tmp_path):
    """The module with fewer samples; a truth in `tmp_path / "room"` and a run's cameras in `tmp_path / "run"`."""
    module = scripts("room")
    for name, count in NUMBERS.items():
        monkeypatch.setattr(module, name, count)
    rng = np.random.default_rng(0)
    poses, views = {}, []
    for index in range(12):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
        pose[:3, 3] = SIZE * rng.uniform(0.3, 0.7, 3)
        poses[f"{index}.jpg"] = pose.tolist()
        estimate = pose.copy()
        estimate[:3, 3] += rng.normal(size=3) * (1.0 if index < 2 else 0.01)  # the first two are placed wrongly
        viewmat = np.eye(4)
        viewmat[:3, :3] = (TURN @ estimate[:3, :3]).T
        viewmat[:3, 3] = -viewmat[:3, :3] @ (SCALE * TURN @ estimate[:3, 3] + SHIFT)
        K = [[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]
        record = {"name": f"{index}.jpg", "width": 640, "height": 480, "viewmat": viewmat.tolist(), "K": K}
        views.append({**record, "held_out": False})
    for folder in ("room", "run"):
        (tmp_path / folder).mkdir()
    (tmp_path / "room/poses.json").write_text(json.dumps({"poses": poses}))
    (tmp_path / "run/cameras.json").write_text(json.dumps(views))
    save(room(), tmp_path / "room/truth_mesh.ply", in_run=False)
    return module


def test_the_truth_itself_scores_as_its_floor_and_a_missing_wall_costs_its_share(script, tmp_path):
    save(room(), tmp_path / "run/mesh.ply")
    save(room(without=(1,)), tmp_path / "run/open.ply")
    scores = script.run([str(tmp_path / "run"), str(tmp_path / "run/open.ply")], str(tmp_path / "room"))
    whole, opened, floor, aligned = scores.values()
    assert [*scores][2:] == ["floor: drawn anew", "floor: aligned anew"]
    for name in ("accuracy_cm", "completeness_cm", "F10", "normal_error_deg"):
        assert whole[name] == pytest.approx(floor[name], rel=0.1, abs=0.2), name
        assert aligned[name] == pytest.approx(floor[name], rel=0.1, abs=0.2), name
    assert floor["F10"] > 0.99 and floor["accuracy_cm"] < 2
    recall = 1 - SIZE[1] * SIZE[2] / (2 * (SIZE[0] * SIZE[1] + SIZE[0] * SIZE[2] + SIZE[1] * SIZE[2]))
    assert opened["F10"] == pytest.approx(2 * recall / (1 + recall), abs=0.03)


def test_what_cannot_be_aligned_is_one_line(script, tmp_path):
    with pytest.raises(InputError, match="neither a mesh nor a folder of a run with a mesh.ply"):
        script.run([str(tmp_path / "run")], str(tmp_path / "room"))
    save(room(), tmp_path / "run/mesh.ply")
    views = json.loads((tmp_path / "run/cameras.json").read_text())
    (tmp_path / "run/cameras.json").write_text(json.dumps(views[:3]))
    with pytest.raises(InputError, match="3 of its photos are the truth's; it takes 4"):
        script.run([str(tmp_path / "run")], str(tmp_path / "room"))
