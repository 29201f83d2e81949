import os
import re
import struct
import zipfile

import numpy as np
import pytest
from glb_chunks import glb_chunks, glb_of
from PIL import Image

from gsjax.errors import InputError
from gsjax.meshing.atlas import Atlas, TexturedMesh
from gsjax.meshing.export import read_mesh, read_textured, write_mesh, write_textured
from gsjax.scene.meshes import Mesh


@pytest.fixture
def mesh():
    """Skewed, off the origin, with a duplicate vertex and an unused one: nothing may be merged, moved or reordered."""
    rng = np.random.default_rng(0)
    vertices = (rng.normal(size=(12, 3)) * [1, 10, 100] + [3, -2, 1000]).astype(np.float32)
    vertices[5] = vertices[2]
    faces = np.array([[0, 1, 2], [2, 1, 3], [5, 4, 6], [7, 8, 9], [9, 8, 10]], np.int32)
    return Mesh(vertices, faces, rng.integers(0, 256, (12, 3), dtype=np.uint8))


@pytest.mark.parametrize("name", ["m.ply", "M.GLB", "m.obj"])
def test_round_trip_is_exact(tmp_path, mesh, name):
    """OBJ keeps the triangles but not the order of vertices, and float32 to its last digit."""
    write_mesh(tmp_path / name, mesh)
    result = read_mesh(tmp_path / name)
    if name != "m.obj":
        np.testing.assert_array_equal(result.vertices, mesh.vertices)
        np.testing.assert_array_equal(result.faces, mesh.faces)
    np.testing.assert_allclose(result.vertices[result.faces], mesh.vertices[mesh.faces], rtol=1e-7, atol=1e-7)
    np.testing.assert_array_equal(result.colors[result.faces], mesh.colors[mesh.faces])
    assert (result.vertices.dtype, result.faces.dtype, result.colors.dtype) == (np.float32, np.int32, np.uint8)


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("m.stl", r"m\.stl: mesh files end in \.ply, \.obj, \.glb"),
        ("m.usdz", r"m\.usdz: mesh files end in \.ply, \.obj, \.glb"),
        ("m.ply", "m.ply: no such mesh file"),
    ],
)
def test_a_file_that_cannot_be_a_mesh_is_named(tmp_path, mesh, name, fault):
    with pytest.raises(InputError, match=fault):
        read_mesh(tmp_path / name)
    if name == "m.stl":
        with pytest.raises(InputError, match=fault):
            write_mesh(tmp_path / name, mesh)
    assert not list(tmp_path.iterdir())


@pytest.fixture
def textured(mesh):
    """Every triangle has its own quarter or so of a picture without any symmetry, and vertices on seams."""
    rng = np.random.default_rng(1)
    faces = np.arange(15, dtype=np.int32).reshape(5, 3)
    atlas = Atlas(rng.uniform(0.05, 0.95, (15, 2)).astype(np.float32), mesh.faces.ravel(), faces, 32, 5)
    return TexturedMesh(mesh, atlas, rng.integers(0, 256, (32, 32, 3), dtype=np.uint8))


def nearest(picture, uvs):
    """Texels under places whose y points down."""
    rows, columns = np.floor(uvs[:, ::-1] * len(picture)).astype(int).T
    return picture[rows, columns]


@pytest.mark.parametrize("name", ["m.glb", "m 1 #2.obj"])
def test_a_texture_round_trips(tmp_path, textured, name):
    write_textured(tmp_path / name, textured)
    result = read_textured(tmp_path / name)
    np.testing.assert_array_equal(result.texture, textured.texture)
    corners = textured.mesh.faces
    np.testing.assert_allclose(
        result.mesh.vertices[result.mesh.faces], textured.mesh.vertices[corners], rtol=1e-7, atol=1e-7
    )
    ours, theirs = textured.atlas.uvs[textured.atlas.faces], result.atlas.uvs[result.atlas.faces]
    np.testing.assert_allclose(theirs, ours, atol=1e-6)
    np.testing.assert_array_equal(result.mesh.faces, result.atlas.faces)
    # A reader that knows of no textures shows what they hold at the corners.
    colored_mesh = read_mesh(tmp_path / name)
    np.testing.assert_array_equal(
        colored_mesh.colors[colored_mesh.faces].reshape(-1, 3), nearest(textured.texture, ours.reshape(-1, 2))
    )


def test_an_obj_of_any_name_says_what_lies_beside_it(tmp_path, textured):
    name = b"k\xfcche"  # in Latin-1
    write_textured(tmp_path / os.fsdecode(name + b".obj"), textured)
    assert (tmp_path / os.fsdecode(name + b".obj")).read_bytes().startswith(b"mtllib " + name + b".mtl\n")
    assert name + b".png" in (tmp_path / os.fsdecode(name + b".mtl")).read_bytes()


def test_textured_glb_is_unlit_and_nothing_is_multiplied_with_the_texture(tmp_path, textured):
    write_textured(tmp_path / "m.glb", textured)
    header, _ = glb_chunks((tmp_path / "m.glb").read_bytes())
    (material,), (image,) = header["materials"], header["images"]
    assert "KHR_materials_unlit" in material["extensions"]
    assert "KHR_materials_unlit" not in header.get("extensionsRequired", [])
    assert material["pbrMetallicRoughness"].get("baseColorFactor", [1, 1, 1, 1]) == [1, 1, 1, 1]
    assert image["mimeType"] == "image/png"
    (primitive,) = header["meshes"][0]["primitives"]
    assert "COLOR_0" not in primitive["attributes"]


def test_a_failed_write_of_a_texture_leaves_the_old_files(tmp_path, textured, monkeypatch):
    write_textured(tmp_path / "m.obj", textured)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savetxt", full)
    other = TexturedMesh(textured.mesh, textured.atlas, 255 - textured.texture)
    with pytest.raises(InputError, match="No space left"):
        write_textured(tmp_path / "m.obj", other)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def _without_view(tree):
    del tree["accessors"][0]["bufferView"]


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda tree: tree.update(extensionsRequired=["KHR_draco_mesh_compression"]), "needs KHR_draco"),
        (lambda tree: tree.update(extensionsRequired=["KHR_materials_unlit"]), None),
        (_without_view, "a sparse or an absent table of numbers, which is not read"),
    ],
)
def test_a_glb_whose_triangles_are_not_in_it_is_refused(tmp_path, mesh, change, fault):
    write_mesh(tmp_path / "m.glb", mesh)
    tree, binary = glb_chunks((tmp_path / "m.glb").read_bytes())
    change(tree)
    (tmp_path / "m.glb").write_bytes(glb_of(tree, binary))
    if fault is None:
        np.testing.assert_array_equal(read_mesh(tmp_path / "m.glb").faces, mesh.faces)
    else:
        with pytest.raises(InputError, match=fault):
            read_mesh(tmp_path / "m.glb")


def test_a_usdz_is_what_its_document_says(tmp_path):
    """Files stored as they are, at multiples of 64 bytes, the scene first; the numbers are those of the mesh."""
    random = np.random.default_rng(0)
    faces = np.arange(12, dtype=np.int32).reshape(4, 3)
    mesh = Mesh(random.normal(size=(12, 3)).astype(np.float32), faces, np.full((12, 3), 90, np.uint8))
    uvs = random.uniform(size=(12, 2)).astype(np.float32)
    texture = random.integers(0, 256, (8, 8, 3), np.uint8)
    path = tmp_path / "m.usdz"
    write_textured(path, TexturedMesh(mesh, Atlas(uvs, np.arange(12, dtype=np.int32), faces, 8, 0), texture))
    whole = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        scene, picture = archive.infolist()
        for entry in (scene, picture):
            name, extra = struct.unpack_from("<HH", whole, entry.header_offset + 26)
            assert (entry.header_offset + 30 + name + extra) % 64 == 0
            assert entry.compress_type == zipfile.ZIP_STORED
        text = archive.read(scene).decode()
        assert scene.filename == "scene.usda" and f"@{picture.filename}@" in text
        np.testing.assert_array_equal(np.asarray(Image.open(archive.open(picture))), texture)

    def numbers(name):
        (array_text,) = re.findall(rf"{re.escape(name)} = \[(.*?)\]", text)
        return np.array(re.findall(r"[-\d.e+]+", array_text), np.float64)

    np.testing.assert_array_equal(numbers("points").astype(np.float32).reshape(-1, 3), mesh.vertices)
    np.testing.assert_array_equal(numbers("faceVertexIndices").reshape(-1, 3), faces)
    np.testing.assert_allclose(numbers("primvars:st").reshape(-1, 2), uvs * [1, -1] + [0, 1], atol=1e-7)
    with pytest.raises(InputError, match="m.ply: meshes with a texture end in .obj, .glb, .usdz"):
        write_textured(tmp_path / "m.ply", TexturedMesh(mesh, Atlas(uvs, faces.ravel(), faces, 8, 0), texture))
