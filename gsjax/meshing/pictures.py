"""Pictures of a mesh without a display: rays against triangles on the CPU.

A shading is a function from what the rays hit to colours; hand in one of those below or your own.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gsjax.mesh import Mesh, face_normals
from gsjax.meshing.libraries import load_open3d

BACKGROUND = np.ones(3)
BACK_FACE = np.array([0.45, 0.0, 0.0])  # Dark red: seen from its inner side.


@dataclass(frozen=True)
class Hits:
    """R pixels that see the mesh."""

    depths: np.ndarray  # [R] camera z, scene units
    normals: np.ndarray  # [R, 3] unit face normals, camera axes (x right, y down, z forward)
    colors: np.ndarray  # [R, 3] vertex colours at the hit, 0..1
    rays: np.ndarray  # [R, 3] unit directions away from the camera, camera axes


Shading = Callable[[Hits], np.ndarray]


def vertex_colors(hits: Hits) -> np.ndarray:
    """`[R, 3]` the mesh's own colours."""
    return hits.colors


def normal_colors(hits: Hits) -> np.ndarray:
    """`[R, 3]` camera-space normals as (n + 1) / 2, with y up and z towards the camera as is usual in pictures."""
    return (hits.normals * np.array([1.0, -1.0, -1.0]) + 1) / 2


def headlight(hits: Hits) -> np.ndarray:
    """`[R, 3]` grey, brightest where the surface faces the camera."""
    facing = np.abs(np.sum(hits.normals * hits.rays, axis=-1, keepdims=True))
    return np.broadcast_to(0.15 + 0.8 * facing, hits.rays.shape)


def render_mesh(
    mesh: Mesh, viewmat: np.ndarray, K: np.ndarray, width: int, height: int, *, shading: Shading = vertex_colors
) -> np.ndarray:
    """`[H, W, 3]` uint8 picture on white; surfaces seen from their inner side are dark red.

    Args:
        mesh: What to show.
        viewmat: `[4, 4]` world to camera, OpenCV axes.
        K: `[3, 3]` pixels; pixel centres at +0.5.
        width: Pixels.
        height: Pixels.
        shading: Colours in 0..1 of what the rays hit.
    """
    hits, pixels = _cast(mesh, viewmat, K, width, height)
    is_back = np.sum(hits.normals * hits.rays, axis=-1, keepdims=True) > 0
    picture = np.broadcast_to(BACKGROUND, (height * width, 3)).copy()
    picture[pixels] = np.where(is_back, BACK_FACE, shading(hits))
    return np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8).reshape(height, width, 3)


def depth_of_mesh(mesh: Mesh, viewmat: np.ndarray, K: np.ndarray, width: int, height: int) -> np.ndarray:
    """`[H, W]` float32 camera z of the nearest triangle at every pixel centre, 0 where there is none."""
    hits, pixels = _cast(mesh, viewmat, K, width, height)
    depth = np.zeros(height * width, np.float32)
    depth[pixels] = hits.depths
    return depth.reshape(height, width)


def _cast(mesh: Mesh, viewmat, K, width: int, height: int) -> tuple[Hits, np.ndarray]:
    """What each ray hits first, and the flat indices of the pixels that hit something."""
    o3d = load_open3d()
    viewmat, K = np.asarray(viewmat, np.float64), np.asarray(K, np.float64)
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    ones = np.ones(height * width)
    in_camera = np.stack([(columns.ravel() - K[0, 2]) / K[0, 0], (rows.ravel() - K[1, 2]) / K[1, 1], ones], axis=-1)
    origin = -viewmat[:3, :3].T @ viewmat[:3, 3]

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(np.ascontiguousarray(mesh.vertices, np.float32), mesh.faces.astype(np.uint32))
    rays = np.concatenate([np.broadcast_to(origin, in_camera.shape), in_camera @ viewmat[:3, :3]], axis=1)
    answer = scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))

    # A ray's direction has z = 1 in the camera, so its parameter is the depth.
    depths = answer["t_hit"].numpy()
    pixels = np.flatnonzero(np.isfinite(depths))
    faces = answer["primitive_ids"].numpy()[pixels]
    u, v = answer["primitive_uvs"].numpy()[pixels].T
    corners = mesh.colors[mesh.faces[faces]] / 255.0
    hits = Hits(
        depths=depths[pixels],
        normals=face_normals(mesh)[faces] @ viewmat[:3, :3].T,
        colors=np.einsum("rk,rkc->rc", np.stack([1 - u - v, u, v], axis=-1), corners),
        rays=in_camera[pixels] / np.linalg.norm(in_camera[pixels], axis=-1, keepdims=True),
    )
    return hits, pixels
