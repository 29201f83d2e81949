"""Damaged meshes: read, or refused in one line; what is read can be drawn."""

import numpy as np
import pytest
from fuzzing import fuzz_files

from gsjax.errors import InputError
from gsjax.meshing.atlas import Atlas, TexturedMesh
from gsjax.meshing.export import glb_bytes, read_mesh, read_textured, write_mesh, write_textured
from gsjax.scene.meshes import Mesh

ASCII = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face {count}
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
1 1 0
{last}
{faces}
"""
TEXTURED = "textured"


def write_sample(path, kind):
    """Writes the file of a mesh; a material and a picture may lie beside it."""
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(90, 3)).astype(np.float32)
    faces, colors = rng.integers(0, 90, (150, 3), np.int32), rng.integers(0, 256, (90, 3), np.uint8)
    mesh = Mesh(corners, faces, colors)
    if kind == "ascii":
        path.write_text(ASCII.format(count=60, last="0 1 0", faces="4 0 1 2 3\n3 1 2 3\n" * 30))
    elif kind == TEXTURED:
        atlas = Atlas(rng.uniform(size=(90, 2)).astype(np.float32), np.arange(90, dtype=np.int32), faces, 4, 0)
        write_textured(path, TexturedMesh(mesh, atlas, rng.integers(0, 256, (4, 4, 3), np.uint8)))
    else:
        write_mesh(path, mesh)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("m.ply", "ascii"),
        ("m.ply", "coloured"),
        ("m.obj", "coloured"),
        ("m.obj", TEXTURED),
        ("m.glb", "coloured"),
        ("m.glb", TEXTURED),
    ],
)
def test_fuzz_meshes(tmp_path, name, kind):
    path = tmp_path / name
    write_sample(path, kind)

    def read():
        textured = read_textured(path)
        mesh = read_mesh(path) if textured is None else textured.mesh
        assert np.isfinite(mesh.vertices[mesh.faces]).all(), "of vertices that are there"
        assert mesh.colors.shape == mesh.vertices.shape
        glb_bytes(path)

    read_whole, refused = fuzz_files(read, path, usual=150 if name.endswith(".glb") else 50)
    assert refused
    assert read_whole


@pytest.mark.parametrize(
    ("last", "faces", "fault"),
    [
        ("0 1 0", "3 0 1 9", "not among its 4"),
        ("0 1 0", "3 0 1 -1", "not among its 4"),
        ("0 1 nan", "3 0 1 2", "1 of 4 vertices are not finite"),
        ("0 1e300 0", "3 0 1 2", "1 of 4 vertices are not finite"),
    ],
)
def test_triangles_that_stand_nowhere_are_refused(tmp_path, last, faces, fault):
    path = tmp_path / "m.ply"
    path.write_text(ASCII.format(count=1, last=last, faces=faces))
    with pytest.raises(InputError, match=fault):
        read_mesh(path)
