"""What glTF has its own way in GLB files: colours and far places.

Colours are linear: 16 bits keep all 256 values of sRGB apart, 8 would not. Positions are float32: where that would lose
them, they stand about a point near by, which is the translation of their node.
"""

import json

import numpy as np

from gsjax.colors import linear_to_srgb, srgb_to_linear, to_bytes
from gsjax.io.json_files import plain
from gsjax.io.place_files import EXTRAS
from gsjax.mesh import Mesh
from gsjax.meshing.libraries import load_trimesh
from gsjax.place import UNPLACED, Place
from gsjax.similarity import loses_in_float32, of_points

OWN = "_color"  # What trimesh takes along untouched; it would write colours of its own in 8 bits.
COMPONENTS = {5121: np.dtype("u1"), 5123: np.dtype("<u2"), 5126: np.dtype("<f4")}
CHANNELS = {"VEC3": 3, "VEC4": 4}
HARMLESS = ("KHR_materials_", "EXT_materials_")  # Extensions of materials, without which the triangles are the same.


def encode_glb(mesh: Mesh, place: Place = UNPLACED, *, unlit: bool = False) -> bytes:
    """A mesh as a GLB, its colours linear.

    Args:
        mesh: What to write.
        place: What is known of the world that it lies in, for the extras of the asset.
        unlit: Whether viewers are told to show the colours as they are: photos hold their light.
    """
    linear = np.ones((mesh.num_vertices, 4))
    linear[:, :3] = srgb_to_linear(mesh.colors / 255)
    attributes = {OWN: np.rint(65535 * linear).astype(np.uint16)}
    vertices, offset = about_offset(mesh.vertices)
    surface = load_trimesh().Trimesh(vertices, mesh.faces, vertex_attributes=attributes, process=False)

    def completed(tree: dict) -> None:
        primitive = tree["meshes"][0]["primitives"][0]
        primitive["attributes"]["COLOR_0"] = primitive["attributes"].pop(OWN)
        tree["accessors"][primitive["attributes"]["COLOR_0"]]["normalized"] = True
        shift_meshes(tree, offset)
        state_place(tree, place)
        if unlit:
            mark_unlit(tree)

    return surface.export(file_type="glb", tree_postprocessor=completed)


def about_offset(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`[V, 3]` vertices that float32 can hold, and the point `[3]` float64 that they stand about."""
    offset = np.asarray(of_points(vertices).center) if loses_in_float32(vertices) else np.zeros(3)
    return vertices - offset.astype(vertices.dtype), offset


def shift_meshes(tree: dict, offset: np.ndarray) -> None:
    """Moves the meshes of a glTF tree by `offset` `[3]`, where that is not zero."""
    for node in tree["nodes"]:
        if "mesh" in node and offset.any():
            node["translation"] = offset.tolist()


def state_place(tree: dict, place: Place) -> None:
    """Says in the extras of a glTF tree's asset what is known of its place."""
    if place.is_known:
        tree["asset"].setdefault("extras", {})[EXTRAS] = plain(place.statement())


def mark_unlit(tree: dict) -> None:
    """Adds KHR_materials_unlit to the material of a glTF tree with one mesh, and a material where there is none."""
    tree.setdefault("materials", [{}])[0]["extensions"] = {"KHR_materials_unlit": {}}
    tree["extensionsUsed"] = [*tree.get("extensionsUsed", ()), "KHR_materials_unlit"]
    tree["meshes"][0]["primitives"][0].setdefault("material", 0)


def unread_part(content: bytes) -> str | None:
    """What of a GLB's triangles trimesh would take for zeros: compressed ones, and numbers that are not in the file."""
    tree = _tree(content)
    needed = [name for name in tree.get("extensionsRequired", ()) if not name.startswith(HARMLESS)]
    if needed:
        return f"needs {', '.join(needed)}, which is not read; save it without"
    if any("bufferView" not in accessor for accessor in tree.get("accessors", ())):
        return "promises numbers that are not in it"
    return None


def vertex_colors(content: bytes) -> np.ndarray | None:
    """`[V, 3]` uint8 sRGB of a GLB that is one primitive with vertex colours, times its material's; None of another."""
    length, tree = _length(content), _tree(content)
    primitives = [primitive for mesh in tree["meshes"] for primitive in mesh["primitives"]]
    if len(primitives) != 1 or "COLOR_0" not in primitives[0]["attributes"]:
        return None
    accessor = tree["accessors"][primitives[0]["attributes"]["COLOR_0"]]
    if "bufferView" not in accessor or "sparse" in accessor:
        return None
    view, kind = tree["bufferViews"][accessor["bufferView"]], COMPONENTS[accessor["componentType"]]
    channels = CHANNELS[accessor["type"]]
    stored = np.ndarray(
        (accessor["count"], channels),
        kind,
        content,
        28 + length + view.get("byteOffset", 0) + accessor.get("byteOffset", 0),  # Behind two headers of chunks.
        (view.get("byteStride", channels * kind.itemsize), kind.itemsize),
    )
    material = tree["materials"][primitives[0]["material"]] if "material" in primitives[0] else {}
    factor = np.array(material.get("pbrMetallicRoughness", {}).get("baseColorFactor", (1.0, 1.0, 1.0))[:3])
    largest = 1 if kind.kind == "f" else np.iinfo(kind).max
    if kind.kind == "f" or (factor != 1).any():
        return srgb_bytes(stored[:, :3] * (factor / largest))
    return srgb_bytes(np.arange(largest + 1) / largest)[stored[:, :3]]


def _length(content: bytes) -> int:
    """Of the JSON, bytes."""
    return int.from_bytes(content[12:16], "little")


def _tree(content: bytes) -> dict:
    return json.loads(content[20 : 20 + _length(content)])


def srgb_bytes(linear: np.ndarray) -> np.ndarray:
    """The uint8 sRGB values of light, 0..1; what is beyond is cut off."""
    return to_bytes(linear_to_srgb(np.clip(linear, 0, 1)))
