"""Meshes of other programs: their colours, indices and missing parts."""

import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.meshing.export import read_mesh


def test_colours_of_faces_are_those_of_their_corners(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 4\n" + "".join(f"property float {a}\n" for a in "xyz")
    header += "element face 2\nproperty list uchar int vertex_indices\n"
    header += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue")) + "end_header\n"
    corners = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
    (tmp_path / "m.ply").write_text(header + corners + "3 0 1 2 255 0 0\n3 0 2 3 0 0 255\n")
    mesh = read_mesh(tmp_path / "m.ply")
    np.testing.assert_array_equal(mesh.colors[mesh.faces], [[[255, 0, 0]] * 3, [[0, 0, 255]] * 3])
    corners = [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], corners)


def test_coloured_parts_of_a_glb_keep_their_colours_and_places(tmp_path):
    """Materials hold light, as colours of vertices do; a part without either is grey in no file of glTF but white."""
    import trimesh

    scene = trimesh.Scene()
    materials = [{"baseColorFactor": [1.0, 0.0, 0.2158605, 1.0]}, {"baseColorFactor": [0.0, 0.5, 0.0, 1.0]}, {}]
    for number, material in enumerate(materials):
        box = trimesh.creation.box()
        box.visual = trimesh.visual.TextureVisuals(material=trimesh.visual.material.PBRMaterial(**material))
        scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([2 * number, 0, 0]))
    box = trimesh.creation.box()
    box.visual.vertex_colors = [0, 55, 255, 255]
    scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([6, 0, 0]))
    scene.export(tmp_path / "m.glb")
    mesh = read_mesh(tmp_path / "m.glb")
    assert mesh.num_faces == 4 * 12
    part = np.rint(mesh.vertices[:, 0] / 2).astype(int)
    expected = np.array([[255, 0, 128], [0, 188, 0], [255, 255, 255], [0, 128, 255]])
    assert np.abs(mesh.colors.astype(int) - expected[part]).max() <= 1


def test_colours_of_a_glb_are_those_of_its_texture_times_the_factor_of_its_material(tmp_path):
    """In light: half of white is 188 of 255."""
    import trimesh
    from PIL import Image

    about = {"baseColorFactor": [0.5, 1.0, 0.0, 1.0], "baseColorTexture": Image.new("RGB", (4, 4), (255, 100, 200))}
    material = trimesh.visual.material.PBRMaterial(**about)
    box = trimesh.creation.box()
    visual = trimesh.visual.TextureVisuals(uv=box.vertices[:, :2], material=material)
    trimesh.Trimesh(box.vertices, box.faces, visual=visual, process=False).export(tmp_path / "textured.glb")
    result = read_mesh(tmp_path / "textured.glb")
    assert np.abs(result.colors.astype(int) - [188, 100, 0]).max() <= 1
    assert result.num_faces == 12


@pytest.mark.parametrize(
    ("kind", "names", "stored"),
    [
        ("float", ("red", "green", "blue"), (1, 0.502, 0)),
        ("float", ("red", "green", "blue"), (255, 128, 0)),
        ("ushort", ("red", "green", "blue"), (65535, 32896, 0)),
        ("uchar", ("diffuse_red", "diffuse_green", "diffuse_blue"), (255, 128, 0)),
        ("uchar", ("r", "g", "b"), (255, 128, 0)),
    ],
)
def test_colours_of_any_type_and_name_are_read(tmp_path, kind, names, stored):
    columns = [*(f"float {axis}" for axis in "xyz"), *(f"{kind} {name}" for name in names)]
    header = ["ply", "format ascii 1.0", "element vertex 3", *(f"property {column}" for column in columns)]
    header += ["element face 1", "property list uchar int vertex_indices", "end_header"]
    rows = [f"{place} {' '.join(map(str, stored))}" for place in ("0 0 0", "1 0 0", "0 1 0")]
    (tmp_path / "m.ply").write_text("\n".join([*header, *rows, "3 0 1 2\n"]))
    np.testing.assert_array_equal(read_mesh(tmp_path / "m.ply").colors, [[255, 128, 0]] * 3)


TRIANGLES = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\n"


@pytest.mark.parametrize(
    ("faces", "fault"),
    [
        ("f 1 2 3\nf 1 2 3 0", "m.obj: 'f 1 2 3 0' is no face: three corners or more, counted from 1"),
        ("f\t1/1\t2/00 3/3\r\n", "m.obj: 'f 1/1 2/00' is no face"),
        ("f 1 2 -5\n", "m.obj: not readable as a mesh .*index -5 is out of bounds"),
        ("f 1 2 3\nf\n", "m.obj: 'f' is no face"),
        ("f 1/1 2/2 3/3\nf 1 2 3 4 1 2\n", "m.obj: lists faces of 5 triangles, of which 2 can be read"),
        ("f 1 2 -x\n", "m.obj: not readable as a mesh .*string or file could not be read to its end"),
        ("f -4 -3 -2\nv 5 5 5\nf -1 1 -2\n", "m.obj: has vertices behind faces that count from the last"),
    ],
)
def test_an_obj_with_an_index_that_is_none_is_refused(tmp_path, faces, fault):
    (tmp_path / "m.obj").write_text(TRIANGLES + faces)
    with pytest.raises(InputError, match=fault):
        read_mesh(tmp_path / "m.obj")


@pytest.mark.parametrize(
    ("faces", "expected"),
    [
        ("f 1 2 3\n", [[0, 1, 2]]),
        ("f -4 -3 -2 # -1\n  f -1 1 -2\n", [[0, 1, 2], [3, 0, 2]]),
        ("# f 0 0 0\nf 1//1 2//1 3//1\n" + "v 9 9 9\n" * 6 + "f 10 1 2\n", [[0, 1, 2], [9, 0, 1]]),
    ],
)
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_indices_of_an_obj_are_those_of_the_format(tmp_path, faces, expected, mark):
    vertices = TRIANGLES[: TRIANGLES.index("vt")]
    (tmp_path / "m.obj").write_text(mark + vertices + faces, encoding="utf-8")
    mesh = read_mesh(tmp_path / "m.obj")
    corners = [line.split()[1:] for line in (vertices + faces).splitlines() if line.startswith("v ")]
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], np.array(corners, np.float32)[expected])


@pytest.mark.parametrize("most", [1, 255])
def test_colours_of_an_obj_are_shares_or_bytes_and_grey_where_there_are_none(tmp_path, capsys, most):
    """Tabs, ends of lines of Windows and lines that go on change nothing."""
    rows = [f"v 0 0 0 {most} 0 {most / 5:g}", f"v\t1 0 0\t0 {most} 0", "v 0 \\\r\n 1 0 0 0 0", "f\t1 2 3"]
    (tmp_path / "m.obj").write_bytes("\r\n".join(rows).encode())
    mesh = read_mesh(tmp_path / "m.obj")
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(mesh.colors, [[255, 0, 51], [0, 255, 0], [0, 0, 0]])
    (tmp_path / "m.obj").write_text("v 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3")
    np.testing.assert_array_equal(read_mesh(tmp_path / "m.obj").colors, np.full((3, 3), 128))
    assert "colours of vertices, which it names, are not those of all vertices" in capsys.readouterr().err
