"""The triangles of GLB files by glTF 2.0: where their nodes place them, with the colour that their material shows.

A material shows its base colour, or its diffuse one (specular-glossiness); where that is black or has no picture, the
light that it emits. Colours of vertices and factors are linear, pictures are sRGB.
"""

import base64
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gsjax.errors import InputError
from gsjax.io.files import read_bytes
from gsjax.meshing.files.glb import srgb_bytes
from gsjax.meshing.files.named_files import NamedFiles
from gsjax.meshing.files.parts import BORDER, Part, clamp_places
from gsjax.scene.colors import srgb_to_linear

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
CHANNELS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
TRIANGLES, STRIP, FAN = 4, 5, 6  # Modes of primitives; all others are points and lines.
CLAMPED, MIRRORED = 33071, 33648  # How a texture is continued outside 0..1; otherwise it is repeated.
# Extensions that are read here, or without which the triangles and their colours are the same.
READ = ("KHR_materials_", "EXT_materials_", "KHR_texture_transform", "KHR_mesh_quantization", "EXT_texture_webp")
SPECULAR_GLOSSINESS, TRANSFORM = "KHR_materials_pbrSpecularGlossiness", "KHR_texture_transform"
HEADER = 20  # bytes before the JSON, and 8 before the binary chunk behind it


def read_glb(path: Path, named: NamedFiles) -> list[Part]:
    """The triangles that a GLB's scene shows, a part for each primitive.

    Raises:
        InputError: It cannot be read, or its triangles need an extension that is not read here, or are not in it.
        ValueError, LookupError, TypeError: It is damaged.
    """
    file = _Glb(path, named)
    needed = [name for name in file.tree.get("extensionsRequired", ()) if not name.startswith(READ)]
    if needed:
        raise InputError(f"{path}: needs {', '.join(needed)}, which is not read; save it without")
    parts = []
    for matrix, mesh in file.placed_meshes():
        for primitive in mesh["primitives"]:
            part = file.part(primitive, matrix)
            parts += [part] if len(part.faces) else []
    used = {primitive.get("material") for _, mesh in file.placed_meshes() for primitive in mesh["primitives"]}
    if all(part.texture is None for part in parts):
        for number, material in enumerate(file.tree.get("materials", ())):
            texture, _ = file.color_texture(material)
            if texture is not None and number not in used:
                named.report_missing(f"texture {texture['index']}", "belongs to a material of no triangle")
    return parts


class _Glb:
    def __init__(self, path: Path, named: NamedFiles):
        content = read_bytes(path)
        length = int.from_bytes(content[12:16], "little")
        self.path, self.named = path, named
        self.tree: dict[str, Any] = json.loads(content[HEADER : HEADER + length])
        self._binary = memoryview(content)[HEADER + length + 8 :]
        self._textures: dict[Any, np.ndarray | None] = {}

    def placed_meshes(self) -> Iterator[tuple[np.ndarray, dict[str, Any]]]:
        """Every mesh of the scene with its `[4, 4]` map to the world."""
        nodes = self.tree.get("nodes", [])
        children = {child for node in nodes for child in node.get("children", ())}
        roots = [index for index in range(len(nodes)) if index not in children]
        if self.tree.get("scenes"):
            roots = self.tree["scenes"][self.tree.get("scene", 0)].get("nodes", [])
        waiting, visited = [(root, np.eye(4)) for root in reversed(roots)], set()
        while waiting:
            index, above = waiting.pop()
            if index in visited:
                raise ValueError(f"node {index} is there twice")
            visited.add(index)
            matrix = above @ _matrix(nodes[index])
            waiting += [(child, matrix) for child in reversed(nodes[index].get("children", ()))]
            if "mesh" in nodes[index]:
                yield matrix, self.tree["meshes"][nodes[index]["mesh"]]

    def part(self, primitive: dict[str, Any], matrix: np.ndarray) -> Part:
        """A primitive's triangles in the world; none of points and lines."""
        attributes = primitive["attributes"]
        vertices = self._numbers(attributes["POSITION"])
        indices = self._numbers(primitive["indices"])[:, 0] if "indices" in primitive else np.arange(len(vertices))
        faces = _triangles(indices, primitive.get("mode", TRIANGLES))
        if (matrix != np.eye(4)).any():
            vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
            faces = faces[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else faces
        info, factor = self.color_texture(
            self.tree["materials"][primitive["material"]] if "material" in primitive else {}
        )
        texture = None if info is None else self._texture(info, factor)
        light = self._light(attributes["COLOR_0"]) if "COLOR_0" in attributes else None
        if texture is None:
            linear = np.asarray(factor[:3], np.float32) * (1 if light is None else light)
            return Part(vertices, faces, np.broadcast_to(srgb_bytes(linear), vertices.shape))
        if light is not None and (light < 1 - 1 / 255).any():
            self.named.report_missing("COLOR_0", "is not multiplied with its texture")
        uvs, texture = self._places(info, attributes, texture)
        return Part(vertices, faces, np.full(vertices.shape, 255, np.uint8), uvs, texture)

    def color_texture(self, material: dict[str, Any]) -> tuple[dict[str, Any] | None, list[float]]:
        """The texture of a material and its linear factor `[3]`, or more channels."""
        base = material.get("pbrMetallicRoughness", {})
        texture, factor = base.get("baseColorTexture"), base.get("baseColorFactor", [1.0, 1.0, 1.0])
        diffuse = material.get("extensions", {}).get(SPECULAR_GLOSSINESS)
        if diffuse is not None and texture is None:
            texture, factor = diffuse.get("diffuseTexture"), diffuse.get("diffuseFactor", [1.0, 1.0, 1.0])
        emitted, light = material.get("emissiveTexture"), material.get("emissiveFactor", [0.0, 0.0, 0.0])
        if any(light) and (not any(factor[:3]) or (texture is None and emitted is not None)):
            return emitted, light
        return texture, factor

    def _light(self, index: int) -> np.ndarray:
        """`[V, 3]` linear colours of vertices, 0..1; those of bytes are shares even where nothing says so."""
        values = self._numbers(index)[:, :3]
        return values if values.dtype.kind == "f" else values / np.float32(np.iinfo(values.dtype).max)

    def _texture(self, info: dict[str, Any], factor: list[float]) -> np.ndarray | None:
        """`[H, W, 3]` uint8 pixels times the factor; None, and a line, where they cannot be read."""
        key = info["index"], tuple(factor[:3])
        if key not in self._textures:
            pixels = self._picture(self.tree["textures"][info["index"]], f"texture {info['index']}")
            if pixels is not None and any(value != 1 for value in factor[:3]):
                tints = srgb_to_linear(np.arange(256) / 255)[:, None] * factor[:3]
                pixels = srgb_bytes(tints)[pixels, np.arange(3)]
            self._textures[key] = pixels
        return self._textures[key]

    def _picture(self, texture: dict[str, Any], name: str) -> np.ndarray | None:
        """The pixels of a texture: of an extension's picture or, where that is of no known format, of its own."""
        of_extensions = [extension.get("source") for extension in texture.get("extensions", {}).values()]
        sources = [source for source in (texture.get("source"), *of_extensions) if source is not None]
        if not sources:
            self.named.report_missing(name, "has no picture")
        for source in sources:
            image = self.tree["images"][source]
            uri = image.get("uri", "data:")
            if not uri.startswith("data:"):
                pixels = self.named.texture(uri)
            else:
                content = self._view(image["bufferView"]) if "bufferView" in image else _of_data_uri(uri)
                pixels = self.named.embedded_texture(name, bytes(content))
            if pixels is not None:
                return pixels
        return None

    def _places(
        self, info: dict[str, Any], attributes: dict[str, int], texture: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """`[V, 2]` places of vertices in a texture that repeats, and that texture."""
        transform = info.get("extensions", {}).get(TRANSFORM, {})
        number = transform.get("texCoord", info.get("texCoord", 0))
        uvs = self._numbers(attributes[f"TEXCOORD_{number}"]) * transform.get("scale", [1.0, 1.0])
        angle = transform.get("rotation", 0.0)  # Counter-clockwise, and v counts downwards.
        uvs = uvs @ [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
        uvs = uvs + transform.get("offset", [0.0, 0.0])
        sampler = self.tree["textures"][info["index"]].get("sampler")
        settings = {} if sampler is None else self.tree["samplers"][sampler]
        for axis, wrap in ((0, settings.get("wrapS")), (1, settings.get("wrapT"))):
            if wrap == MIRRORED and (np.abs(uvs[:, axis] - 0.5) > 0.5 + BORDER).any():
                texture = np.concatenate([texture, np.flip(texture, 1 - axis)], axis=1 - axis)
                uvs[:, axis] /= 2
            elif wrap == CLAMPED:
                uvs[:, axis] = clamp_places(uvs[:, axis], texture.shape[1 - axis])
        return uvs, texture

    def _numbers(self, index: int) -> np.ndarray:
        """`[N, K]` numbers of an accessor; floats where they are normalized."""
        accessor = self.tree["accessors"][index]
        if "bufferView" not in accessor:
            raise InputError(f"{self.path}: promises numbers that are not in it")
        kind, channels = np.dtype(COMPONENTS[accessor["componentType"]]), CHANNELS[accessor["type"]]
        values = self._rows(accessor, kind, channels, accessor["count"])
        if sparse := accessor.get("sparse"):
            values, rows = values.copy(), np.dtype(COMPONENTS[sparse["indices"]["componentType"]])
            changed = self._rows(sparse["values"], kind, channels, sparse["count"])
            values[self._rows(sparse["indices"], rows, 1, sparse["count"])[:, 0]] = changed
        if accessor.get("normalized") and kind.kind != "f":
            return np.maximum(values / np.float32(np.iinfo(kind).max), -1)
        return values

    def _rows(self, stored: dict[str, Any], kind: np.dtype, channels: int, count: int) -> np.ndarray:
        view = self.tree["bufferViews"][stored["bufferView"]]
        strides = view.get("byteStride") or channels * kind.itemsize, kind.itemsize
        return np.ndarray(
            (count, channels), kind, self._view(stored["bufferView"]), stored.get("byteOffset", 0), strides
        )

    def _view(self, index: int) -> memoryview:
        view = self.tree["bufferViews"][index]
        uri = self.tree["buffers"][view["buffer"]].get("uri")
        if uri is None:
            buffer = self._binary
        elif uri.startswith("data:"):
            buffer = memoryview(_of_data_uri(uri))
        elif (file := self.named.find(uri)) is not None:
            buffer = memoryview(read_bytes(file))
        else:
            raise InputError(f"{self.path}: {uri}, which it names, is not in its folder")
        start, length = view.get("byteOffset", 0), view["byteLength"]
        if not 0 <= start <= start + length <= len(buffer):
            raise ValueError("truncated")
        return buffer[start : start + length]


def _matrix(node: dict[str, Any]) -> np.ndarray:
    """`[4, 4]` map from a node to the one above."""
    if "matrix" in node:
        return np.reshape(np.array(node["matrix"], np.float64), (4, 4)).T
    matrix = np.eye(4)
    rotation = Rotation.from_quat(node.get("rotation", [0.0, 0.0, 0.0, 1.0])).as_matrix()
    matrix[:3, :3] = rotation * node.get("scale", [1.0, 1.0, 1.0])
    matrix[:3, 3] = node.get("translation", [0.0, 0.0, 0.0])
    return matrix


def _triangles(indices: np.ndarray, mode: int) -> np.ndarray:
    """`[F, 3]` of `[I]` indices of vertices."""
    if mode == TRIANGLES:
        return indices.reshape(-1, 3)
    if mode == STRIP:
        faces = np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
        faces[1::2] = faces[1::2, ::-1]
        return faces
    if mode == FAN:
        return np.stack([np.full(max(len(indices) - 2, 0), indices[0]), indices[1:-1], indices[2:]], axis=1)
    return np.empty((0, 3), np.int64)


def _of_data_uri(uri: str) -> bytes:
    return base64.b64decode(uri.partition(",")[2])
