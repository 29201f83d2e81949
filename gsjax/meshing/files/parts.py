"""Parts of a mesh file, one a material, and one mesh of them all: with a texture, or with colours of vertices."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gsjax.meshing.files.named_files import NamedFiles

BORDER = 1e-4  # Sides of a texture by which places may lie outside and still mean its border.
INWARDS = 1e-5  # Share of the way to a triangle's centroid: there a corner's texel is one that the triangle shows.
MOST_TEXELS = 2**26  # of a texture that is laid out several times: 8,192 x 8,192


@dataclass(frozen=True)
class Part:
    """V vertices and F triangles that share one material."""

    vertices: np.ndarray  # [V, 3] float
    faces: np.ndarray  # [F, 3] int
    colors: np.ndarray  # [V, 3] uint8 sRGB; shown where there is no texture
    uvs: np.ndarray | None = None  # [V, 2] places in the texture, x to the right, y down
    texture: np.ndarray | None = None  # [H, W, 3] uint8 sRGB, repeated outside 0..1; only with places


def split_corners(
    vertices: np.ndarray, faces: np.ndarray, values: np.ndarray, value_rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`[P, 3]` vertices, `[F, 3]` faces and `[P, K]` values: a vertex for each pair of a vertex and a value.

    A face `[F, 3]` has rows of the vertices `[V, 3]` and, in `value_rows` `[F, 3]`, of the values `[U, K]`.
    """
    keys, corners = np.unique(faces.astype(np.int64) * len(values) + value_rows, return_inverse=True)
    return vertices[keys // len(values)], corners.reshape(-1, 3), values[keys % len(values)]


def without_unused(part: Part) -> Part:
    """The part with only the vertices that its triangles have."""
    rows, corners = np.unique(part.faces, return_inverse=True)
    uvs = None if part.uvs is None else part.uvs[rows]
    return replace(part, vertices=part.vertices[rows], faces=corners.reshape(-1, 3), colors=part.colors[rows], uvs=uvs)


def within_texture(part: Part, named: NamedFiles) -> Part:
    """The same part with places in 0..1: whole sides are subtracted, and what is shown repeatedly is laid out so.

    Where that would take over `MOST_TEXELS`, one line says so, and the vertices' colours are left.
    """
    if part.texture is None or part.uvs is None or (np.abs(part.uvs - 0.5) <= 0.5 + BORDER).all():
        return part
    corners = part.uvs[part.faces]  # [F, 3, 2]
    low = np.floor(corners.min(axis=1) + BORDER)
    across, down = np.maximum(np.ceil(corners.max(axis=1) - BORDER) - low, 1).max(axis=0)
    height, width = part.texture.shape[:2]
    if across * down > 1 and height * width * across * down > MOST_TEXELS:
        fault = f"a triangle shows its texture {max(across, down):.0f} times, too often to be laid out"
        named.report_missing("a texture", f"cannot be laid out ({fault})")
        return replace(part, uvs=None, texture=None)
    shifts, rows = np.unique(low, axis=0, return_inverse=True)
    vertices, faces, tiles = split_corners(
        np.hstack([part.vertices, part.uvs, part.colors]), part.faces, shifts, np.repeat(rows.reshape(-1, 1), 3, axis=1)
    )
    texture = np.tile(part.texture, (int(down), int(across), 1))
    uvs = (vertices[:, 3:5] - tiles) / [across, down]
    return Part(vertices[:, :3], faces, vertices[:, 5:].astype(np.uint8), uvs, texture)


def clamp_places(places: np.ndarray, side: int) -> np.ndarray:
    """`[V]` places along one side of a texture, in texels, whose border continues outside 0..1.

    Those outside come to the middle of the outermost texel: the border itself is also that of the next repetition.
    """
    if (np.abs(places - 0.5) <= 0.5 + BORDER).all():
        return places
    inset = max(0.5 / side, 2 * BORDER)
    return np.clip(places, inset, 1 - inset)


def merge_parts(parts: Sequence[Part]) -> Part:
    """One part of some, with places in 0..1: with a texture where all have one or one colour, else with colours."""
    if len(parts) == 1:
        return parts[0]
    if any(part.texture is not None for part in parts):
        parts = [_with_texture(part) for part in parts]
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    vertices = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)])
    colors = np.concatenate([shown_colors(part) for part in parts])
    if any(part.texture is None for part in parts):
        return Part(vertices, faces, colors)
    uvs, texture = _in_one_picture(parts)
    return Part(vertices, faces, colors, uvs, texture)


def shown_colors(part: Part) -> np.ndarray:
    """`[V, 3]` uint8 sRGB, what a part shows at its vertices: its texture, if it has one."""
    if part.uvs is None or part.texture is None:
        return part.colors
    corners, places = part.uvs[part.faces].astype(np.float64), part.uvs.astype(np.float64)
    places[part.faces] = corners + INWARDS * (corners.mean(axis=1, keepdims=True) - corners)
    sides = np.array(part.texture.shape[1::-1])
    columns, rows = np.clip(places * sides, 0, sides - 1).astype(np.int64).T
    return part.texture[rows, columns]


def _with_texture(part: Part) -> Part:
    """The part with a texture of one texel, where it has none and is of one colour."""
    if part.texture is not None or (part.colors != part.colors[0]).any():
        return part
    return replace(part, uvs=np.full((len(part.vertices), 2), 0.5), texture=part.colors[:1, None])


def _in_one_picture(parts: Sequence[Part]) -> tuple[np.ndarray, np.ndarray]:
    """Places of all parts in one texture, and that texture: rows of pictures, the tallest first."""
    pictures = {id(part.texture): part.texture for part in parts if part.texture is not None}
    if len(pictures) == 1:
        return np.concatenate([part.uvs for part in parts if part.uvs is not None]), next(iter(pictures.values()))
    area = sum(picture.shape[0] * picture.shape[1] for picture in pictures.values())
    width = max(math.isqrt(area), *(picture.shape[1] for picture in pictures.values()))
    x = y = height = 0
    corners = {}
    for key, picture in sorted(pictures.items(), key=lambda item: -item[1].shape[0]):
        if x + picture.shape[1] > width:
            x, y = 0, height
        corners[key] = x, y
        x, height = x + picture.shape[1], max(height, y + picture.shape[0])
    texture = np.zeros((height, width, 3), np.uint8)
    for key, (x, y) in corners.items():
        texture[y : y + pictures[key].shape[0], x : x + pictures[key].shape[1]] = pictures[key]
    uvs = [
        (np.clip(part.uvs, 0, 1) * part.texture.shape[1::-1] + corners[id(part.texture)]) / [width, height]
        for part in parts
        if part.uvs is not None and part.texture is not None
    ]
    return np.concatenate(uvs), texture
