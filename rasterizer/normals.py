"""The normal of a Gaussian: its smallest axis, turned towards the camera."""

import jax
import jax.numpy as jnp
from jax import Array

from rasterizer.covariances import dot, rotation
from rasterizer.projection import camera_position


def _normal(mean: Array, quat: Array, scale: Array, viewmat: Array) -> Array:
    axes, smallest = jnp.stack([jnp.stack(row) for row in rotation(quat)]), jnp.argmin(scale)
    axis = list(jnp.take(axes, smallest, axis=1))
    in_camera = [dot(list(viewmat[i, :3]), axis) for i in range(3)]
    towards_scene = dot(in_camera, camera_position(mean, viewmat)) > 0
    return jnp.where(jax.lax.stop_gradient(towards_scene), -1, 1) * jnp.stack(in_camera)


def camera_normals(means: Array, quats: Array, scales: Array, viewmats: Array, visible: Array) -> Array:
    """Unit normals of N Gaussians in C camera frames (OpenCV axes), facing the camera.

    Args:
        means: `[N, 3]` world positions; they only decide the sign.
        quats: `[N, 4]` rotations (w, x, y, z) of any length.
        scales: `[N, 3]`; they only decide which axis is the smallest.
        viewmats: `[C, 4, 4]` world to camera.
        visible: `[C, N]` bool; the others get zero, with zero gradient, whatever they hold.

    Returns:
        `[C, N, 3]`, differentiable to quats and viewmats.
    """

    def one(mean, quat, scale, viewmat, visible):
        safe = jnp.where(visible, quat, jnp.array([1, 0, 0, 0], quat.dtype))
        mean, scale = jnp.where(visible, mean, 0), jnp.where(visible, scale, 1)
        return jnp.where(visible, _normal(mean, safe, scale, viewmat), 0)

    one_camera = jax.vmap(one, in_axes=(0, 0, 0, None, 0))
    return jax.vmap(one_camera, in_axes=(None, None, None, 0, 0))(means, quats, scales, viewmats, visible)
