"""The triangles of PLY files, with colours of vertices or faces, or the pictures that comments name."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.io import ply
from gsjax.io.packages import require
from gsjax.meshing.files.mtl import GREY
from gsjax.meshing.files.named_files import NamedFiles
from gsjax.meshing.files.parts import Part, split_corners, without_unused
from gsjax.scene.colors import shares, to_bytes

_PICTURE = re.compile(rb"^comment\s+TextureFile\s+(.+?)\s*$", re.M | re.I)
LONGEST_HEADER = 2**16  # bytes


def read_ply(path: Path, named: NamedFiles) -> list[Part]:
    """The triangles of a PLY: a part for each picture, or one with colours of vertices.

    Raises:
        InputError: It cannot be read.
        ValueError, LookupError, TypeError: It is damaged.
    """
    with path.open("rb") as file:
        header = file.read(LONGEST_HEADER).partition(b"\nend_header")[0]
        names = [name.decode("utf-8", "surrogateescape") for name in _PICTURE.findall(header)]
        textures = [named.texture(name) for name in names]
        has_texture = any(texture is not None for texture in textures)
        file.seek(0)
        loaded = require("trimesh").exchange.ply.load_ply(file, skip_materials=True, fix_texture=has_texture)
    elements = loaded.pop("metadata")["_ply_raw"]
    numbers = _texture_numbers(elements) if len(textures) > 1 else np.empty(0, int)
    del elements  # All of the file once more.
    if loaded.get("faces") is None:
        return []
    part = _colored(path, loaded, named)
    uvs = getattr(loaded.get("visual"), "uv", None)
    if not has_texture:
        return [part]
    if uvs is None:
        named.report_missing(names[0], "has no places for its triangles")
        return [part]
    uvs = np.asarray(uvs) * [1, -1] + [0, 1]
    if len(textures) == 1:
        return [replace(part, uvs=uvs, texture=textures[0])]
    if len(numbers) != len(part.faces):
        named.report_missing(" and ".join(names), "are not told apart by its triangles")
        return [part]
    texture_of = {number: textures[number] if 0 <= number < len(textures) else None for number in np.unique(numbers)}
    return [
        without_unused(replace(part, faces=part.faces[numbers == number], uvs=uvs, texture=texture))
        for number, texture in texture_of.items()
    ]


def _colored(path: Path, loaded: dict[str, Any], named: NamedFiles) -> Part:
    """All triangles with the colours of their vertices or, where these have none, of faces."""
    vertices, polygons = loaded["vertices"], loaded["faces"]
    faces = require("trimesh").geometry.triangulate_quads(polygons)
    colors, of_faces = ply.read_vertex_colors(path), loaded.get("face_colors")
    if colors is None and loaded.get("vertex_colors") is not None:  # Vertices with lists.
        colors = _bytes(loaded["vertex_colors"])
    if colors is not None and len(colors) == len(vertices):
        return Part(vertices, faces, colors)
    if of_faces is not None and np.shape(polygons)[1:] in ((3,), (4,)):
        halves = len(faces) // len(of_faces)  # of quads, all first ones before all second ones
        colors, rows = np.unique(np.tile(_bytes(of_faces), (halves, 1)), axis=0, return_inverse=True)
        return Part(*split_corners(vertices, faces, colors, np.repeat(rows.reshape(-1, 1), 3, axis=1)))
    if of_faces is not None:
        named.report_missing("colours of faces", "belong to polygons of several kinds")
    return Part(vertices, faces, np.full(vertices.shape, GREY, np.uint8))


def _bytes(colors: np.ndarray) -> np.ndarray:
    """`[N, 3]` uint8 of colours of any type."""
    return colors[:, :3] if colors.dtype == np.uint8 else to_bytes(shares(colors[:, :3]))


def _texture_numbers(elements: dict[str, Any]) -> np.ndarray:
    """`[F]` numbers of faces' pictures in the order of the comments, as MeshLab and OpenMVS write them; or none."""
    try:
        return np.asarray(elements["face"]["data"]["texnumber"])
    except (LookupError, TypeError, ValueError):
        return np.empty(0, int)
