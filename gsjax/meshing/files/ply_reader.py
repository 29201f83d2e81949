"""The triangles of PLY files, with colours of vertices or faces, or the picture that a comment names."""

import re
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gsjax.errors import InputError
from gsjax.io import ply
from gsjax.io.packages import require
from gsjax.meshing.files.named_files import NamedFiles
from gsjax.meshing.files.parts import GREY, Part, from_above
from gsjax.scene.colors import shares, to_bytes

_PICTURE = re.compile(rb"^comment\s+TextureFile\s+(.+?)\s*$", re.M | re.I)
LONGEST_HEADER = 2**16  # bytes


def read_ply(path: Path, named: NamedFiles) -> list[Part]:
    """The triangles of a PLY as one part, with its picture or with colours of vertices.

    Raises:
        InputError: It cannot be read, or has several pictures.
        ValueError, LookupError, TypeError: It is damaged.
    """
    with path.open("rb") as file:
        header = file.read(LONGEST_HEADER).partition(b"\nend_header")[0]
        names = [name.decode("utf-8", "surrogateescape") for name in _PICTURE.findall(header)]
        if len(names) > 1:
            raise InputError(f"{path}: has {len(names)} pictures; save it with one, or as an OBJ")
        texture = _texture(names[0], named) if names else None
        file.seek(0)
        loaded = require("trimesh").exchange.ply.load_ply(file, skip_materials=True, fix_texture=texture is not None)
    del loaded["metadata"]  # All of the file once more.
    if loaded.get("faces") is None:
        return []
    part, uvs = _colored(path, loaded, named), getattr(loaded.get("visual"), "uv", None)
    if names and (texture is None or uvs is None):
        named.report_picture(names[0])
        return [part]
    return [part if uvs is None or not names else replace(part, uvs=from_above(uvs), texture=texture)]


def _texture(name: str, named: NamedFiles) -> np.ndarray | None:
    try:
        return named.pixels(Image.open(BytesIO(named.get(name))))
    except OSError:
        return None


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
        corners = np.repeat(np.tile(_bytes(of_faces), (halves, 1)), 3, axis=0)
        return Part(vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3), corners)
    if of_faces is not None:
        named.report_missing("colours of faces", "belong to polygons of several kinds")
    return Part(vertices, faces, np.full(vertices.shape, GREY, np.uint8))


def _bytes(colors: np.ndarray) -> np.ndarray:
    """`[N, 3]` uint8 of colours of any type."""
    return colors[:, :3] if colors.dtype == np.uint8 else to_bytes(shares(colors[:, :3]))
