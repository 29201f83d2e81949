"""Pinhole cameras: frames, pixel conventions, and the maps of one point.

World to camera is `viewmat`; camera axes are x right, y down, z forward (OpenCV). Pixel (row i, column j) has its
centre at (j + 0.5, i + 0.5). Depth is camera z.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from gsjax.numerics import times

NEAREST = 1e-6  # Camera z up to which a point is on the camera's plane, or behind it


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Camera:
    """A pinhole view. The matrices are traced, so a new pose or focal length never recompiles; the size is static."""

    viewmat: Float[Array, "4 4"]  # rigid, world to camera
    K: Float[Array, "3 3"]  # pixels: fx, fy, cx, cy
    width: int = field(metadata={"static": True})
    height: int = field(metadata={"static": True})


def rotation(camera: Camera) -> Array:
    """`[3, 3]` rotation of world vectors into the camera frame."""
    return camera.viewmat[:3, :3]


def center(camera: Camera) -> Array:
    """`[3]` camera centre in the world."""
    return -jnp.sum(camera.viewmat[:3, :3] * camera.viewmat[:3, 3, None], axis=0)


def viewmat_center(viewmat: np.ndarray) -> np.ndarray:
    """`[3]` world centre of the camera with a `[4, 4]` viewmat; numpy, of its dtype."""
    return -viewmat[:3, :3].T @ viewmat[:3, 3]


def viewmat_centers(viewmats: np.ndarray) -> np.ndarray:
    """`[V, 3]` world centres of the cameras with `[V, 4, 4]` viewmats (or their upper three rows); numpy."""
    return -np.einsum("vji,vj->vi", viewmats[:, :3, :3], viewmats[:, :3, 3])


class Landing(NamedTuple):
    """Where in a view points land; all `[...]`, numpy."""

    rows: np.ndarray  # int, 0 where not `inside`
    columns: np.ndarray
    depths: np.ndarray  # float64 camera z, of any sign
    inside: np.ndarray  # bool: before the camera, and within its picture


def landing(points: np.ndarray, viewmat: np.ndarray, K: np.ndarray, size: tuple[int, int]) -> Landing:
    """The pixels that world points `[..., 3]` land on in a view of `size` (height, width), reckoned in float64."""
    viewmat, K = np.asarray(viewmat, np.float64), np.asarray(K, np.float64)
    local = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    depths = local[..., 2]
    ahead = depths > NEAREST
    pixels = np.floor(local[..., :2] / np.where(ahead, depths, 1.0)[..., None] * K[[0, 1], [0, 1]] + K[:2, 2])
    inside = ahead & ((pixels >= 0) & (pixels < size[::-1])).all(axis=-1)
    columns, rows = np.moveaxis(np.where(inside[..., None], pixels, 0).astype(np.int64), -1, 0)
    return Landing(rows, columns, depths, inside)


def thinned_K(K: np.ndarray, stride: int) -> np.ndarray:
    """`[3, 3]` float64 intrinsics of a view of which every `stride`-th pixel is kept, the first at `stride // 2`."""
    small = K.astype(np.float64)
    small[:2, 2] -= stride // 2 + 0.5
    small[:2] /= stride
    small[:2, 2] += 0.5
    return small


def world_to_camera(point: Array, camera: Camera) -> Array:
    """`[3]` camera-frame position of one world point."""
    return times(camera.viewmat[:3, :3], point) + camera.viewmat[:3, 3]


def project(point_cam: Array, camera: Camera) -> Array:
    """`[2]` pixel (x, y) of one camera-frame point; points on or behind the camera plane are read at z = 1e-6."""
    z = jnp.where(point_cam[2] > NEAREST, point_cam[2], NEAREST)
    return point_cam[:2] / z * jnp.stack([camera.K[0, 0], camera.K[1, 1]]) + camera.K[:2, 2]


def pixel_rays(camera: Camera) -> Float[Array, "{camera.height} {camera.width} 3"]:
    """Camera-frame ray through every pixel centre, with z = 1: times depth it is the point."""
    x = (jnp.arange(camera.width, dtype=camera.K.dtype) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    y = (jnp.arange(camera.height, dtype=camera.K.dtype) + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    x, y = jnp.meshgrid(x, y)
    return jnp.stack([x, y, jnp.ones_like(x)], axis=-1)


def unproject(depth: Array, camera: Camera) -> Array:
    """`[H, W, 3]` camera-frame points of a `[H, W]` depth map (camera z)."""
    return pixel_rays(camera) * depth[..., None]


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    """`[4, 4]` float32 viewmat, numpy, of a camera at `eye` with `target` in the middle; any turn if it looks along up.

    All are `[3]`, world; `up` is the direction that points up in the image, of any length.
    """
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up / np.linalg.norm(up))
    if np.linalg.norm(right) < 1e-6:
        right = np.cross(forward, np.roll(up, 1))
    right /= np.linalg.norm(right)
    viewmat = np.eye(4)
    viewmat[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    viewmat[:3, 3] = -viewmat[:3, :3] @ eye
    return viewmat.astype(np.float32)
