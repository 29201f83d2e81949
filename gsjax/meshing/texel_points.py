"""The texels of an atlas that are on the surface: which point each one shows, and paint for those around them."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from gsjax.meshing.atlas import Atlas, doubled_areas, texel_corners
from gsjax.meshing.ray_queries import Cast, ray_caster
from gsjax.scene.meshes import Mesh

RAYS_AT_ONCE = 1 << 20
GROWTH = 0.02  # Texels by which a triangle's corners are moved out before rays are cast at it.


@dataclass(frozen=True)
class Texels:
    """M texels that show a point of the surface; each belongs to one triangle."""

    where: np.ndarray  # [M] int32 row times the texture's side plus column
    faces: np.ndarray  # [M] int32
    points: np.ndarray  # [M, 3] float32 world positions
    colors: np.ndarray  # [M, 3] uint8 of the vertices around


def texels_of(mesh: Mesh, atlas: Atlas) -> Texels:
    """Texels whose centres are in a triangle; a triangle too small for any gets the one under its centroid if free.

    Found in bands of rows, with about a million texels in work at a time.
    """
    corners = texel_corners(atlas)
    cast, rows = ray_caster(_lying(corners)), max(RAYS_AT_ONCE // atlas.size, 1)
    bands = [_covered(cast, atlas.size, first, min(first + rows, atlas.size)) for first in range(0, atlas.size, rows)]
    where, faces = (np.concatenate(parts).astype(np.int32) for parts in zip(*bands, strict=True))
    where, faces = _with_small_triangles(where, faces, corners, atlas.size)
    points, colors = np.empty((len(where), 3), np.float32), np.empty((len(where), 3), np.uint8)
    for first in range(0, len(where), RAYS_AT_ONCE):
        part = slice(first, first + RAYS_AT_ONCE)
        weights = barycentrics(corners[faces[part]], where[part], atlas.size)
        around = mesh.faces[faces[part]]
        points[part] = np.einsum("mk,mkd->md", weights, mesh.vertices[around])
        colors[part] = np.rint(np.einsum("mk,mkd->md", weights, mesh.colors[around]))
    return Texels(where, faces, points, colors)


def barycentrics(corners: np.ndarray, where: np.ndarray, size: int) -> np.ndarray:
    """`[M, 3]` weights of the corners `[M, 3, 2]` at the texels' centres, moved into the triangle where outside."""
    centers = np.stack([where % size, where // size], axis=-1) + 0.5
    whole = doubled_areas(corners)
    parts = [
        doubled_areas(np.stack([centers, corners[:, (k + 1) % 3], corners[:, (k + 2) % 3]], axis=1)) for k in range(3)
    ]
    is_flat = np.abs(whole) < 1e-9
    weights = np.stack(parts, axis=-1) / np.where(is_flat, 1, whole)[:, None]
    inside = np.clip(np.where(is_flat[:, None], 1.0, weights), 0, 1)
    return inside / inside.sum(axis=-1, keepdims=True)


def paint_texture(texels: Texels, colors: np.ndarray, size: int) -> np.ndarray:
    """`[size, size, 3]` uint8 picture of the texels' `colors` `[M, 3]`; every other texel has its nearest one's.

    So nothing foreign shows where sampling or a mipmap reads beyond the border of a chart.
    """
    image = np.zeros((size * size, 3), np.uint8)
    image[texels.where] = colors
    is_empty = np.ones(size * size, bool)
    is_empty[texels.where] = False
    if is_empty.any() and len(texels.where):
        nearest = ndimage.distance_transform_edt(
            is_empty.reshape(size, size), return_distances=False, return_indices=True
        )
        assert nearest is not None
        image = image[nearest[0].ravel() * np.int64(size) + nearest[1].ravel()]
    return image.reshape(size, size, 3)


def _lying(corners: np.ndarray) -> Mesh:
    """The triangles in the plane z = 0, a little larger: centres exactly on a border shall be met for certain."""
    away = corners - corners.mean(axis=1, keepdims=True)
    away /= np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-12)
    places = (corners + GROWTH * away).reshape(-1, 2)
    return Mesh(
        np.pad(places, ((0, 0), (0, 1))).astype(np.float32),
        np.arange(len(places), dtype=np.int32).reshape(-1, 3),
        np.zeros((len(places), 3), np.uint8),
    )


def _covered(cast: Cast, size: int, first_row: int, end_row: int) -> tuple[np.ndarray, np.ndarray]:
    """Flat indices of the texels of some rows that a triangle covers, and the triangles."""
    columns, rows = np.meshgrid(np.arange(size) + 0.5, np.arange(first_row, end_row) + 0.5)
    origins = np.stack([columns.ravel(), rows.ravel(), np.ones(columns.size)], axis=-1)
    hits = cast(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape))
    covered = np.flatnonzero(np.isfinite(hits.distances))
    return first_row * size + covered, hits.faces[covered]


def _with_small_triangles(
    where: np.ndarray, faces: np.ndarray, corners: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """The same texels and those under the centroids of triangles that cover no centre, where nothing else is."""
    is_left = np.ones(len(corners), bool)
    is_left[faces] = False
    left = np.flatnonzero(is_left)
    columns, rows = np.clip(corners[left].mean(axis=1).astype(np.int64), 0, size - 1).T
    texels, first = np.unique(rows * size + columns, return_index=True)
    is_free = ~np.isin(texels, where)
    return (
        np.concatenate([where, texels[is_free]]).astype(np.int32),
        np.concatenate([faces, left[first[is_free]]]).astype(np.int32),
    )
