"""Parts of a mesh file, one a material, and one mesh of them all: with a texture, or with colours of vertices."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gsjax.io.messages import print_once
from gsjax.meshing.cleaning import concatenate_meshes
from gsjax.scene.meshes import Mesh

GREY = 128  # of what has no colour
BORDER = 1e-4  # Sides of a texture by which places may lie outside and still mean its border.
INWARDS = 1e-5  # Share of the way to a triangle's centroid: there a corner's texel is one that the triangle shows.


@dataclass(frozen=True)
class Part:
    """V vertices and F triangles that share one material."""

    vertices: np.ndarray  # [V, 3] float
    faces: np.ndarray  # [F, 3] int
    colors: np.ndarray  # [V, 3] uint8 sRGB; shown where there is no texture
    uvs: np.ndarray | None = None  # [V, 2] places in the texture, x to the right, y down
    texture: np.ndarray | None = None  # [H, W, 3] uint8 sRGB, repeated outside 0..1; only with places


def from_above(uvs: np.ndarray) -> np.ndarray:
    """`[V, 2]` places whose y points down, of those whose y points up."""
    return np.column_stack([uvs[:, 0], 1 - uvs[:, 1]])


def merge_parts(path: Path, parts: Sequence[Part]) -> Part:
    """Return one part: with the texture if all parts show the same one, once; else with colours of vertices.

    A line reports the texture that becomes colours of vertices.
    """
    parts = [_near_texture(part) for part in parts]
    first = parts[0].texture
    mesh = concatenate_meshes([Mesh(part.vertices, part.faces, shown_colors(part)) for part in parts])
    fault = None
    if not all(_equal(part.texture, first) for part in parts):
        fault = "only a mesh with one texture keeps it"
    elif first is not None and not all(map(is_within_texture, parts)):
        fault = "its texture repeats"
    if fault is not None:
        print_once(f"{path}: {fault}; it is read with colours of vertices")
    if fault is not None or first is None:
        return Part(mesh.vertices, mesh.faces, mesh.colors)
    uvs = np.concatenate([part.uvs for part in parts if part.uvs is not None])
    return Part(mesh.vertices, mesh.faces, mesh.colors, uvs, first)


def shown_colors(part: Part) -> np.ndarray:
    """`[V, 3]` uint8 sRGB, what a part shows at its vertices: its texture, if it has one."""
    if part.uvs is None or part.texture is None:
        return part.colors
    corners, places = part.uvs[part.faces].astype(np.float64), part.uvs.astype(np.float64)
    places[part.faces] = corners + INWARDS * (corners.mean(axis=1, keepdims=True) - corners)
    if not is_within_texture(part):
        places %= 1
    sides = np.array(part.texture.shape[1::-1])
    columns, rows = np.clip(places * sides, 0, sides - 1).astype(np.int64).T
    return part.texture[rows, columns]


def _near_texture(part: Part) -> Part:
    """Return the part with places moved by whole sides of the texture, the least one to 0..1."""
    return part if part.uvs is None else replace(part, uvs=part.uvs - np.floor(part.uvs.min(axis=0) + BORDER))


def is_within_texture(part: Part) -> bool:
    """Whether the part shows no place of its texture beyond 0..1."""
    return part.uvs is None or bool((np.abs(part.uvs - 0.5) <= 0.5 + BORDER).all())


def _equal(texture: np.ndarray | None, other: np.ndarray | None) -> bool:
    return texture is other or (texture is not None and other is not None and np.array_equal(texture, other))
