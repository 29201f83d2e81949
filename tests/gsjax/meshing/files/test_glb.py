"""Vertex colours of GLB files against glTF's definition: COLOR_0 is linear."""

import numpy as np
import pytest
from glb_chunks import glb_chunks, glb_of

from gsjax.meshing.export import read_mesh, write_mesh
from gsjax.meshing.files import glb
from gsjax.scene.meshes import Mesh


def every_value():
    """A strip of triangles whose vertices have all 256 values, of each channel its own."""
    vertices = np.stack([np.arange(256) // 2, np.arange(256) % 2, np.zeros(256)], -1).astype(np.float32)
    faces = np.stack([np.arange(254), np.arange(1, 255), np.arange(2, 256)], -1).astype(np.int32)
    levels = np.arange(256, dtype=np.uint8)
    return Mesh(vertices, faces, np.stack([levels, levels[::-1], np.roll(levels, 40)], -1))


def light(colors):
    """Of uint8 sRGB, one value after the other (IEC 61966-2-1)."""
    return np.array([v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in np.ravel(colors) / 255])


def test_the_file_holds_light_in_normalized_16_bits():
    mesh = every_value()
    tree, binary = glb_chunks(glb.encode_glb(mesh, unlit=True))
    (primitive,) = tree["meshes"][0]["primitives"]
    accessor = tree["accessors"][primitive["attributes"]["COLOR_0"]]
    assert (accessor["componentType"], accessor["normalized"], accessor["type"]) == (5123, True, "VEC4")
    assert all(name.isupper() for name in primitive["attributes"]), "nothing but what glTF names"
    start = tree["bufferViews"][accessor["bufferView"]]["byteOffset"]
    stored = np.frombuffer(binary, "<u2", 4 * 256, start).reshape(256, 4) / 65535
    np.testing.assert_allclose(stored[:, :3].ravel(), light(mesh.colors), atol=0.5 / 65535 + 1e-12)
    np.testing.assert_array_equal(stored[:, 3], 1)
    assert "KHR_materials_unlit" in tree["extensionsUsed"]


def test_every_value_comes_back_as_it_was(tmp_path):
    mesh = every_value()
    write_mesh(tmp_path / "m.glb", mesh)
    result = read_mesh(tmp_path / "m.glb")
    np.testing.assert_array_equal(result.colors, mesh.colors)
    np.testing.assert_array_equal(result.vertices, mesh.vertices)


@pytest.mark.parametrize(("component", "kind", "unit", "atol"), [(5126, "<f4", 1.0, 0), (5121, "u1", 255, 6)])
def test_files_of_others_hold_light_too_in_floats_or_in_8_bits(tmp_path, component, kind, unit, atol):
    """8 bits of light are few where it is dark: sRGB 12 and 13 are one of them."""
    mesh = every_value()
    tree, binary = glb_chunks(glb.encode_glb(mesh))
    values = unit * light(mesh.colors).reshape(-1, 3)
    stored = np.ones((256, 4), kind)
    stored[:, :3] = values if component == 5126 else np.rint(values)
    accessor = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    accessor |= {"componentType": component, "bufferView": len(tree["bufferViews"])}
    del accessor["min"], accessor["max"]
    tree["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": stored.nbytes})
    binary += stored.tobytes()
    tree["buffers"][0]["byteLength"] = len(binary)
    (tmp_path / "m.glb").write_bytes(glb_of(tree, binary))
    np.testing.assert_allclose(read_mesh(tmp_path / "m.glb").colors.astype(int), mesh.colors, atol=atol)
