"""Pictures of a mesh without a display: rays against triangles on the CPU.

A shading is a function from what the rays hit to colours; pass one of those below or your own.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gsjax.meshing.atlas import TexturedMesh
from gsjax.meshing.ray_queries import Cast, front_faces_only, ray_caster
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera, viewmat_center
from gsjax.scene.meshes import Mesh, face_normals

SIDE = 4  # Rays along a pixel, and down it, whose mean is its colour where edges are to be smooth.
RAYS_AT_ONCE = 1 << 20
BACK_FACE = np.array([0.45, 0.0, 0.0])  # Dark red: seen from its inner side.


@dataclass(frozen=True)
class Hits:
    """R pixels that see the mesh."""

    depths: np.ndarray  # [R] camera z, scene units
    normals: np.ndarray  # [R, 3] unit face normals, camera axes (x right, y down, z forward)
    colors: np.ndarray  # [R, 3] vertex colours at the hit, 0..1
    rays: np.ndarray  # [R, 3] unit directions away from the camera, camera axes
    faces: np.ndarray  # [R] triangles
    barycentrics: np.ndarray  # [R, 3] weights of their corners


Shading = Callable[[Hits], np.ndarray]


def vertex_colors(hits: Hits) -> np.ndarray:
    """`[R, 3]` the mesh's own colours."""
    return hits.colors


def headlight(hits: Hits) -> np.ndarray:
    """`[R, 3]` grey, brightest where the surface faces the camera."""
    facing = np.abs(np.sum(hits.normals * hits.rays, axis=-1, keepdims=True))
    return np.broadcast_to(0.15 + 0.8 * facing, hits.rays.shape)


def texture_colors(textured: TexturedMesh) -> Shading:
    """The shading that shows a texture, read bilinearly."""
    texture = textured.texture.reshape(-1, 3).astype(np.float32) / 255

    def shading(hits: Hits) -> np.ndarray:
        texels, weights = texels_around(textured, hits)
        return np.einsum("rk,rkc->rc", weights, texture[texels])

    return shading


def shading_of(textured: TexturedMesh | None) -> Shading:
    """The shading by the texture; of a mesh without one, by the colours of its vertices."""
    return vertex_colors if textured is None else texture_colors(textured)


def texels_around(textured: TexturedMesh, hits: Hits) -> tuple[np.ndarray, np.ndarray]:
    """`[R, 4]` rows of the flat texture that a bilinear reading mixes at each hit, and their weights."""
    atlas, (height, width) = textured.atlas, textured.texture.shape[:2]
    sides = np.array([width, height])
    at = np.einsum("rk,rkd->rd", hits.barycentrics, atlas.uvs[atlas.faces[hits.faces]]) * sides - 0.5
    low = np.floor(at).astype(np.int64)
    u, v = (at - low).T
    columns, rows = (np.clip(low[:, None] + [[0, 0], [1, 0], [0, 1], [1, 1]], 0, sides - 1)).transpose(2, 0, 1)
    return rows * width + columns, np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], axis=1)


def render_mesh(
    mesh: Mesh, camera: Camera, *, shading: Shading = vertex_colors, cast: Cast | None = None
) -> np.ndarray:
    """`[H, W, 3]` uint8 picture on white; surfaces seen from their inner side are dark red.

    `cast` is the mesh's `ray_caster`, where many pictures share it.
    """
    hits, pixels = _hits(mesh, cast or ray_caster(mesh), camera)
    is_back = np.sum(hits.normals * hits.rays, axis=-1, keepdims=True) > 0
    picture = np.ones((camera.height * camera.width, 3))
    picture[pixels] = np.where(is_back, BACK_FACE, shading(hits))
    return np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8).reshape(camera.height, camera.width, 3)


def smooth_pictures(
    mesh: Mesh, cameras: Sequence[Camera], *, shading: Shading = vertex_colors, side: int = SIDE
) -> Iterator[Picture]:
    """What each camera sees of a mesh from outside, over black: the means of many rays a pixel, as viewers draw edges.

    There are `side` rays along a pixel, and as many down it.
    """
    cast = front_faces_only(mesh, ray_caster(mesh))
    for camera in cameras:
        sums = np.zeros((camera.height * camera.width, 5), np.float32)
        for hits, pixels in rays_in_bands(mesh, cast, camera, side):
            samples = np.column_stack([shading(hits), hits.depths, np.ones(len(pixels))])
            sums += np.stack([np.bincount(pixels, column, len(sums)) for column in samples.T], axis=1)
        sums = sums.reshape(camera.height, camera.width, 5)
        hit = sums[..., 4]
        yield Picture(
            colors=np.clip(sums[..., :3] / side**2, 0, 1),
            depth=np.where(hit > 0, sums[..., 3] / np.maximum(hit, 1), 0),
            alphas=hit / side**2,
        )


def rays_in_bands(mesh: Mesh, cast: Cast, camera: Camera, side: int) -> Iterator[tuple[Hits, np.ndarray]]:
    """What `side` times `side` rays a pixel hit, some rows of pixels at a time, and `[R]` the flat pixel of each."""
    rows = max(1, RAYS_AT_ONCE // (camera.width * side * side))
    width = camera.width * side
    for first in range(0, camera.height, rows):
        K = np.asarray(camera.K, np.float64) - np.array([[0, 0, 0], [0, 0, first], [0, 0, 0]])
        height = min(rows, camera.height - first) * side
        hits, rays = _hits(mesh, cast, Camera(camera.viewmat, np.diag([side, side, 1]) @ K, width, height))
        y, x = np.divmod(rays, width)
        yield hits, (first + y // side) * camera.width + x // side


def depth_of_mesh(cast: Cast, camera: Camera) -> np.ndarray:
    """`[H, W]` float32 camera z of the nearest triangle at every pixel centre, 0 where there is none."""
    depth = cast(*_pixel_rays(camera)).distances
    return np.where(np.isfinite(depth), depth, 0).reshape(camera.height, camera.width)


def faces_of_pixels(cast: Cast, camera: Camera) -> np.ndarray:
    """`[H, W]` int64, the nearest triangle at every pixel centre, -1 where there is none."""
    hits = cast(*_pixel_rays(camera))
    return np.where(np.isfinite(hits.distances), hits.faces, -1).reshape(camera.height, camera.width)


def _hits(mesh: Mesh, cast: Cast, camera: Camera) -> tuple[Hits, np.ndarray]:
    """What each ray hits first, and the flat indices of the pixels that hit something."""
    origin, directions = _pixel_rays(camera)
    depths, faces, barycentrics = cast(origin, directions)
    pixels = np.flatnonzero(np.isfinite(depths))
    faces, barycentrics = faces[pixels], barycentrics[pixels]
    rotation = np.asarray(camera.viewmat, np.float64)[:3, :3]
    rays = directions[pixels] @ rotation.T
    hits = Hits(
        depths=depths[pixels],
        normals=face_normals(replace(mesh, faces=mesh.faces[faces])) @ rotation.T,
        colors=np.einsum("rk,rkc->rc", barycentrics, mesh.colors[mesh.faces[faces]] / 255.0),
        rays=rays / np.linalg.norm(rays, axis=-1, keepdims=True),
        faces=faces,
        barycentrics=barycentrics,
    )
    return hits, pixels


def _pixel_rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """`[3]` the camera's centre and `[H * W, 3]` directions whose lengths make a ray's parameter the camera z."""
    viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
    right, down, forward = viewmat[:3, :3]
    columns = (np.arange(camera.width) + 0.5 - K[0, 2]) / K[0, 0]
    rows = (np.arange(camera.height) + 0.5 - K[1, 2]) / K[1, 1]
    directions = columns[:, None] * right + (rows[:, None] * down + forward)[:, None]
    return viewmat_center(viewmat), directions.reshape(-1, 3)
