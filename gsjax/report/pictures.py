"""Arrays of colours, depths and normals as pictures of bytes."""

import jax.numpy as jnp
import numpy as np

from gsjax.meshing.pictures import Shading, headlight, render_mesh
from gsjax.meshing.ray_queries import Cast
from gsjax.normals.from_depth import depth_normals
from gsjax.scene.cameras import Camera
from gsjax.scene.colors import to_bytes
from gsjax.scene.meshes import Mesh


def depth_picture(depth: np.ndarray, span: tuple[float, float] | None = None) -> np.ndarray:
    """`[H, W, 3]` uint8 grey: near is light, far is dark, nothing is black.

    Args:
        depth: `[H, W]` camera z, 0 where nothing is.
        span: What is lightest and what darkest; None: `depth_span` of this picture.
    """
    near, far = span or depth_span(depth)
    grey = np.where(depth > 0, 1 - 0.85 * np.clip((depth - near) / max(far - near, 1e-6), 0, 1), 0)
    return to_bytes(np.repeat(grey[..., None], 3, -1))


def depth_span(depths: np.ndarray) -> tuple[float, float]:
    """The depths that all but the nearest and the farthest hundredth are between; 0 and 1 where there are none."""
    valid_depths = depths[depths > 0]
    near, far = np.quantile(valid_depths, [0.01, 0.99]) if len(valid_depths) else (0.0, 1.0)
    return float(near), float(far)


def normal_picture(normals: np.ndarray) -> np.ndarray:
    """`[H, W, 3]` uint8: x to the right red, y up green, towards the camera blue; white where there is none."""
    is_known = np.any(normals != 0, axis=-1, keepdims=True)
    return to_bytes(np.where(is_known, 0.5 + 0.5 * normals * np.array([1, -1, -1]), 1))


def surface_picture(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """`normal_picture` of the surface that a rendered depth `[H, W]` implies."""
    return normal_picture(np.asarray(depth_normals(jnp.asarray(depth), camera)))


def difference_picture(image: np.ndarray, other: np.ndarray, gain: float) -> np.ndarray:
    """`[H, W, 3]` uint8 grey: white where two pictures of bytes are equal, darker by the mean difference of colours."""
    difference = np.abs(image.astype(np.float32) - other.astype(np.float32)).mean(-1, keepdims=True)
    return to_bytes(np.repeat(1 - np.minimum(gain * difference / 255, 1), 3, -1))


def mesh_picture(mesh: Mesh, camera: Camera, shading: Shading = headlight, cast: Cast | None = None) -> np.ndarray:
    """`[H, W, 3]` uint8: a mesh as `camera` sees it."""
    return render_mesh(mesh, camera, shading=shading, cast=cast)
