"""Meshes of a made room, four by three by two and a half metres, against itself."""

import json

import numpy as np
import pytest
import trimesh
from meshes import mesh_of
from scipy.spatial.transform import Rotation

from gsjax.meshing.export import write_mesh
from gsjax.scene.meshes import Mesh

SIZE = np.array([4.0, 3.0, 2.5])
NUMBERS = {"TRUTH_POINTS": 2000, "DENSE_TRUTH": 40_000, "MESH_POINTS": 20_000, "DENSE_MESH": 40_000, "ROUNDS": 12}
TURN, SHIFT, SCALE = Rotation.from_euler("xyz", [40, -70, 110], degrees=True).as_matrix(), np.array([5.0, -2, 1]), 0.4
"""From the truth's world to that of the run: what the cameras must find out."""


def room(*, is_open=False):
    """The six walls of the room, or all but the one at the end of the x axis."""
    box = trimesh.creation.box(SIZE).apply_translation(SIZE / 2)
    faces = box.faces[box.triangles_center[:, 0] < SIZE[0] - 1e-6] if is_open else box.faces
    return mesh_of(box.vertices, faces)


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
    save(room(is_open=True), tmp_path / "run/open.ply")
    scores = script.run([str(tmp_path / "run"), str(tmp_path / "run/open.ply")], str(tmp_path / "room"))
    whole, opened, floor, aligned = scores.values()
    assert [*scores][2:] == ["floor: drawn anew", "floor: aligned anew"]
    for name in ("accuracy_cm", "completeness_cm", "F10", "normal_error_deg"):
        assert whole[name] == pytest.approx(floor[name], rel=0.1, abs=0.2), name
        assert aligned[name] == pytest.approx(floor[name], rel=0.1, abs=0.2), name
    assert floor["F10"] > 0.99 and floor["accuracy_cm"] < 2
    recall = 1 - SIZE[1] * SIZE[2] / (2 * (SIZE[0] * SIZE[1] + SIZE[0] * SIZE[2] + SIZE[1] * SIZE[2]))
    assert opened["F10"] == pytest.approx(2 * recall / (1 + recall), abs=0.03)
