"""What glTF has its own way in GLB files: colours and far places.

Colours are linear: 16 bits keep all 256 values of sRGB apart, 8 would not. Positions are float32: where that would lose
them, they stand about a point near by, which is the translation of their node.
"""

from functools import partial

import numpy as np

from gsjax.io.georeference_files import EXTRAS
from gsjax.io.json_files import plain
from gsjax.io.packages import require
from gsjax.meshing.atlas import TexturedMesh
from gsjax.scene.colors import linear_to_srgb, srgb_to_linear, to_bytes
from gsjax.scene.georeference import UNPLACED, Place
from gsjax.scene.meshes import Mesh
from gsjax.scene.similarity import loses_in_float32, of_points

OWN = "_color"  # What trimesh takes along untouched; it would write colours of its own in 8 bits.


def encode_glb(mesh: Mesh, place: Place = UNPLACED, *, unlit: bool = False) -> bytes:
    """A mesh as a GLB, its colours linear; `unlit` where viewers are to show them as they are: photos hold their light.

    What is known of its place is in the extras of the asset.
    """
    linear = np.ones((mesh.num_vertices, 4))
    linear[:, :3] = srgb_to_linear(mesh.colors / 255)
    attributes = {OWN: np.rint(65535 * linear).astype(np.uint16)}
    vertices, offset = about_offset(mesh.vertices)
    surface = require("trimesh").Trimesh(vertices, mesh.faces, vertex_attributes=attributes, process=False)

    def completed(tree: dict) -> None:
        primitive = tree["meshes"][0]["primitives"][0]
        primitive["attributes"]["COLOR_0"] = primitive["attributes"].pop(OWN)
        tree["accessors"][primitive["attributes"]["COLOR_0"]]["normalized"] = True
        complete_tree(tree, offset, place, unlit=unlit)

    return surface.export(file_type="glb", tree_postprocessor=completed)


def encode_textured(textured: TexturedMesh, place: Place = UNPLACED) -> bytes:
    """A mesh with its texture as a GLB: one vertex a place in the texture. Unlit: photos hold their light already."""
    from PIL import Image

    trimesh, atlas = require("trimesh"), textured.atlas
    picture = Image.fromarray(np.ascontiguousarray(textured.texture))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=1.0)
    visual = trimesh.visual.TextureVisuals(uv=atlas.uvs * [1.0, -1.0] + [0.0, 1.0], material=material)
    vertices, offset = about_offset(textured.mesh.vertices[atlas.vertices])
    surface = trimesh.Trimesh(vertices, atlas.faces, visual=visual, process=False)

    completed = partial(complete_tree, offset=offset, place=place, unlit=True)
    return surface.export(file_type="glb", include_normals=False, tree_postprocessor=completed)


def about_offset(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`[V, 3]` vertices that float32 can hold, and the point `[3]` float64 that they stand about."""
    offset = np.asarray(of_points(vertices).center) if loses_in_float32(vertices) else np.zeros(3)
    return vertices - offset.astype(vertices.dtype), offset


def complete_tree(tree: dict, offset: np.ndarray, place: Place, *, unlit: bool) -> None:
    """Moves the one mesh of a glTF tree by `offset` `[3]`, says what is known of its place, and makes it unlit."""
    for node in tree["nodes"]:
        if "mesh" in node and offset.any():
            node["translation"] = offset.tolist()
    if place.is_known:
        tree["asset"].setdefault("extras", {})[EXTRAS] = plain(place.statement())
    if unlit:
        tree.setdefault("materials", [{}])[0]["extensions"] = {"KHR_materials_unlit": {}}
        tree["extensionsUsed"] = [*tree.get("extensionsUsed", ()), "KHR_materials_unlit"]
        tree["meshes"][0]["primitives"][0].setdefault("material", 0)


def srgb_bytes(linear: np.ndarray) -> np.ndarray:
    """The uint8 sRGB values of light, 0..1; what is beyond is cut off."""
    return to_bytes(linear_to_srgb(np.clip(linear, 0, 1)))
