"""The triangles of GLB files: trimesh reads them, and what it would read wrong is refused.

A material shows its base colour or, where that is black or has no picture, the light that it emits. Colours of
vertices and factors are linear, pictures are sRGB.
"""

import json
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.io.files import read_bytes
from gsjax.io.packages import require
from gsjax.meshing.files.glb import srgb_bytes
from gsjax.meshing.files.named_files import NamedFiles
from gsjax.meshing.files.parts import GREY, Part, from_above, is_within_texture
from gsjax.scene.colors import srgb_to_linear

# Extensions that trimesh reads, or that make no difference to triangles and their colours; and others.
READ = ("KHR_materials_", "EXT_materials_", "EXT_texture_webp")
UNREAD = ("KHR_materials_pbrSpecularGlossiness", "KHR_texture_transform")
FLOAT, REPEATED, FAN = 5126, 10497, 6  # glTF's numbers of a type, of how a texture continues, and of a mode
READ_MODES = 0, 1, 4, 5  # of primitives: points, lines, triangles and strips
HEADER = 20  # bytes before the JSON


def read_glb(path: Path, named: NamedFiles) -> list[Part]:
    """The triangles that a GLB's scene shows, a part for each primitive of each node.

    Raises:
        InputError: It cannot be read, or its triangles or their colours need what trimesh does not read.
        ValueError, LookupError, TypeError: It is damaged.
    """
    content = read_bytes(path)
    tree = json.loads(content[HEADER : HEADER + int.from_bytes(content[12:16], "little")])
    if unread := sorted(set(_unread(tree))):
        raise InputError(f"{path}: needs {', '.join(unread)}, which is not read; save it without")
    trimesh = require("trimesh")
    loaded = trimesh.exchange.gltf.load_glb(BytesIO(content), named)
    read = [each for each in _primitives(tree) if each.get("mode", 4) in READ_MODES]
    primitives = dict(zip(loaded["geometry"], read, strict=True))
    graph, parts = trimesh.scene.transforms.SceneGraph(base_frame=loaded["base_frame"]), []
    for edge in loaded["graph"]:
        graph.update(**edge)
    for node in graph.nodes_geometry:
        matrix, name = graph[node]
        if "faces" in (geometry := loaded["geometry"][name]):
            parts.append(_placed(_part(geometry, tree, _material(tree, primitives[name]), named), matrix))
    wraps = {sampler.get(wrap, REPEATED) for sampler in tree.get("samplers", ()) for wrap in ("wrapS", "wrapT")}
    if wraps - {REPEATED} and not all(map(is_within_texture, parts)):
        raise InputError(f"{path}: shows a texture beyond its border, where it does not repeat, which is not read")
    return parts


def _unread(tree: dict[str, Any]) -> Iterator[str]:
    """Names of what trimesh ignores, though triangles or their places in textures depend on it."""
    yield from (name for name in tree.get("extensionsRequired", ()) if not name.startswith(READ))
    if any("camera" in node and ("mesh" in node or node.get("children")) for node in tree.get("nodes", ())):
        yield "a camera that holds a mesh"
    for primitive in _primitives(tree):
        attributes, material = primitive["attributes"], _material(tree, primitive)
        numbers = {name: tree["accessors"][index] for name, index in attributes.items()}
        indices = [tree["accessors"][primitive["indices"]]] if "indices" in primitive else []
        if any("sparse" in each or "bufferView" not in each for each in (*numbers.values(), *indices)):
            yield "a sparse or an absent table of numbers"
        if any(numbers[name]["componentType"] != FLOAT for name in ("POSITION", "TEXCOORD_0") if name in numbers):
            yield "places in integers"
        if primitive.get("mode") == FAN:
            yield "a fan of triangles"
        info = _color_texture(material)[1] or {}
        yield from (name for name in (*material.get("extensions", ()), *info.get("extensions", ())) if name in UNREAD)
        if info.get("texCoord", 0) != 0:
            yield f"TEXCOORD_{info['texCoord']}"


def _primitives(tree: dict[str, Any]) -> list[dict[str, Any]]:
    return [primitive for mesh in tree.get("meshes", ()) for primitive in mesh["primitives"]]


def _material(tree: dict[str, Any], primitive: dict[str, Any]) -> dict[str, Any]:
    return tree["materials"][primitive["material"]] if "material" in primitive else {}


def _color_texture(material: dict[str, Any]) -> tuple[str, dict[str, Any] | None, list[float]]:
    """The name of a material's texture, its entry in the file, and its linear factor `[3]`, or more channels."""
    base = material.get("pbrMetallicRoughness", {})
    texture, factor = base.get("baseColorTexture"), base.get("baseColorFactor", [1.0, 1.0, 1.0])
    emitted, light = material.get("emissiveTexture"), material.get("emissiveFactor", [0.0, 0.0, 0.0])
    if any(light) and (not any(factor[:3]) or (texture is None and emitted is not None)):
        return "emissiveTexture", emitted, light
    return "baseColorTexture", texture, factor


def _part(geometry: dict[str, Any], tree: dict[str, Any], material: dict[str, Any], named: NamedFiles) -> Part:
    """The triangles of a primitive, before its node places them."""
    vertices, faces, visual = geometry["vertices"], geometry["faces"], geometry.get("visual")
    light = geometry.get("vertex_colors", getattr(visual, "vertex_attributes", {}).get("color"))
    if light is not None:  # Those of bytes are shares even where nothing says so.
        light = light[:, :3] if light.dtype.kind == "f" else light[:, :3] / np.float32(np.iinfo(light.dtype).max)
    name, info, factor = _color_texture(material)
    pixels = None if visual is None else named.pixels(getattr(visual.material, name))
    if visual is None or visual.uv is None or pixels is None:
        if info is not None:
            named.report_missing(f"texture {info['index']}", "is no picture of its triangles that can be read")
        linear = np.asarray(factor[:3], np.float32) * (1 if light is None else light)
        return Part(vertices, faces, np.broadcast_to(srgb_bytes(linear), vertices.shape))
    if light is not None and (light < 1 - 1 / 255).any():
        named.report_missing("COLOR_0", "is not multiplied with its texture")
    if any(value != 1 for value in factor[:3]):
        tints = srgb_to_linear(np.arange(256) / 255)[:, None] * factor[:3]
        pixels = srgb_bytes(tints)[pixels, np.arange(3)]
    return Part(vertices, faces, np.full(vertices.shape, GREY, np.uint8), from_above(visual.uv), pixels)


def _placed(part: Part, matrix: np.ndarray) -> Part:
    """The part in the world, by its node's `[4, 4]` map."""
    if (matrix == np.eye(4)).all():
        return part
    faces = part.faces[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else part.faces
    return replace(part, vertices=part.vertices @ matrix[:3, :3].T + matrix[:3, 3], faces=faces)
