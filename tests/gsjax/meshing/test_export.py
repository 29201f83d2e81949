import json
import struct

import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.mesh import Mesh
from gsjax.meshing import read_mesh, write_mesh


@pytest.fixture
def mesh():
    """Skewed, off the origin, with a duplicate vertex and an unused one: nothing may be merged, moved or reordered."""
    rng = np.random.default_rng(0)
    vertices = (rng.normal(size=(12, 3)) * [1, 10, 100] + [3, -2, 1000]).astype(np.float32)
    vertices[5] = vertices[2]
    faces = np.array([[0, 1, 2], [2, 1, 3], [5, 4, 6], [7, 8, 9], [9, 8, 10]], np.int32)
    return Mesh(vertices, faces, rng.integers(0, 256, (12, 3), dtype=np.uint8))


@pytest.mark.parametrize("name", ["m.ply", "m.glb", "M.GLB", "m.PLY"])
def test_round_trip_is_exact(tmp_path, mesh, name):
    write_mesh(tmp_path / name, mesh)
    found = read_mesh(tmp_path / name)
    np.testing.assert_array_equal(found.vertices, mesh.vertices)
    np.testing.assert_array_equal(found.faces, mesh.faces)
    np.testing.assert_array_equal(found.colors, mesh.colors)
    assert (found.vertices.dtype, found.faces.dtype, found.colors.dtype) == (np.float32, np.int32, np.uint8)


def test_round_trip_through_obj_keeps_float32(tmp_path, mesh):
    write_mesh(tmp_path / "m.obj", mesh)
    found = read_mesh(tmp_path / "m.obj")
    np.testing.assert_allclose(found.vertices[found.faces], mesh.vertices[mesh.faces], rtol=1e-7, atol=1e-7)
    np.testing.assert_array_equal(found.colors[found.faces], mesh.colors[mesh.faces])


def test_obj_text_is_ours(tmp_path, mesh):
    write_mesh(tmp_path / "m.obj", mesh)
    lines = (tmp_path / "m.obj").read_text().splitlines()
    vertices = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    np.testing.assert_allclose(vertices[:, :3], mesh.vertices, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(vertices[:, 3:], mesh.colors / 255, atol=1e-6)
    faces = [[int(part.split("/")[0]) for part in line.split()[1:]] for line in lines if line.startswith("f ")]
    np.testing.assert_array_equal(np.array(faces) - 1, mesh.faces)


def test_glb_holds_the_scenes_own_axes(tmp_path, mesh):
    write_mesh(tmp_path / "m.glb", mesh)
    data = (tmp_path / "m.glb").read_bytes()
    header = json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])
    position = header["accessors"][header["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    np.testing.assert_allclose(position["min"], mesh.vertices.min(0), rtol=1e-6)
    np.testing.assert_allclose(position["max"], mesh.vertices.max(0), rtol=1e-6)
    for node in header["nodes"]:
        assert np.allclose(node.get("matrix", np.eye(4).ravel()), np.eye(4).ravel())
        assert not {"rotation", "translation", "scale"} & node.keys()


def test_unknown_suffix_names_the_known(tmp_path, mesh):
    for call in (lambda p: write_mesh(p, mesh), read_mesh):
        with pytest.raises(InputError, match=r"m\.stl.*\.ply, \.obj, \.glb"):
            call(tmp_path / "m.stl")
    assert not list(tmp_path.iterdir())


def test_a_failed_write_leaves_the_old_file(tmp_path, mesh, monkeypatch):
    import trimesh

    target = tmp_path / "m.ply"
    write_mesh(target, mesh)
    before = target.read_bytes()

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(trimesh.Trimesh, "export", full)
    with pytest.raises(InputError, match="No space left"):
        write_mesh(target, mesh)
    assert target.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["m.ply"]


@pytest.mark.parametrize("name", ["m.ply", "m.obj", "m.glb"])
def test_broken_files_are_one_line_with_the_name(tmp_path, mesh, name):
    with pytest.raises(InputError, match="no such mesh file"):
        read_mesh(tmp_path / name)
    (tmp_path / name).write_bytes(b"\x00garbage\n" * 3)
    with pytest.raises(InputError) as caught:
        read_mesh(tmp_path / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["m.ply", "m.glb"])
def test_truncated_files_are_refused(tmp_path, mesh, name):
    write_mesh(tmp_path / name, mesh)
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:-40])
    with pytest.raises(InputError, match=name):
        read_mesh(tmp_path / name)


def test_no_colours_in_the_file_is_grey(tmp_path):
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    found = read_mesh(tmp_path / "m.obj")
    np.testing.assert_array_equal(found.colors, np.full((3, 3), 128))
