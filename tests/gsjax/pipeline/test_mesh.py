"""A 3DGS file that was not trained here becomes a mesh, by every method; options out of range are one line."""

import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.io.ply import write_gaussians
from gsjax.mesh import signed_volume
from gsjax.meshing.export import read_mesh
from gsjax.pipeline import viewpoints
from gsjax.pipeline.mesh import METHODS, mesh


@pytest.fixture
def file(ball, tmp_path, monkeypatch):
    monkeypatch.setattr(viewpoints, "SIZE", 64)
    write_gaussians(tmp_path / "ball.ply", ball.gaussians)
    return tmp_path / "ball.ply"


@pytest.mark.parametrize("method", METHODS)
def test_any_ply_becomes_a_mesh_without_cameras(file, method, tmp_path):
    report = mesh(file, tmp_path / "mesh.glb", method=method)
    found = read_mesh(tmp_path / "mesh.glb")
    assert found.num_faces == report["faces"] > 1000
    assert report["facing_share"] > 0.99
    radii = np.linalg.norm(found.vertices, axis=1)
    assert np.median(np.abs(radii - 1)) < 0.11
    if method == "poisson":
        assert report["topology"]["watertight"]
        assert signed_volume(found) == pytest.approx(4 / 3 * np.pi, rel=0.06)


def test_a_box_and_a_number_of_faces_are_kept(file, tmp_path):
    box = [-2.0, -2, 0, 2, 2, 2]
    report = mesh(file, tmp_path / "mesh.ply", bounds=box, faces=500)
    assert report["faces"] <= 500
    assert report["foreground"]["box"] == [box[:3], box[3:]]
    assert "background" not in report
    around = mesh(file, tmp_path / "mesh.ply", bounds=box, background_bounds=[-2.0, -2, -2, 2, 2, 2])
    assert around["background"]["points_seen"] > 0


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        ({"method": "nurbs"}, "--method nurbs is none of poisson, tsdf, centers, marching-cubes"),
        ({"level": 1.5}, "--level 1.5"),
        ({"trim_quantile": 1.0}, "--trim-quantile 1.0"),
        ({"points": 0}, "--points 0"),
        ({"depth": 1}, "--depth 1"),
        ({"cell": -0.1}, "--cell -0.1"),
        ({"faces": 0}, "--faces 0"),
        ({"background_bounds": [0, 0, 0, 1, 1, 1]}, "--background-bounds needs --bounds"),
        ({"bounds": [1, 0, 0, 0, 1, 1]}, "min below its max"),
        ({"bounds": [5, 5, 5, 6, 6, 6]}, "holds none of"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_what_cannot_be_done_is_one_line_and_nothing_is_written(file, tmp_path, options, fault):
    with pytest.raises(InputError, match=fault) as caught:
        mesh(file, tmp_path / "mesh.ply", **options)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "mesh.ply").exists()
