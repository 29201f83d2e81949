"""The normal of a Gaussian: its smallest axis, turned towards the camera."""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from rasterizer.arrays import takes_arrays
from rasterizer.camera_models import CAMERA_MODELS, CameraModelName
from rasterizer.covariances import components, dot, matrix_rows, rotation
from rasterizer.ewa import camera_position


@takes_arrays
def camera_normals(
    means: Float[Array, "N 3"],
    quats: Float[Array, "N 4"],
    scales: Float[Array, "N 3"],
    viewmats: Float[Array, "C 4 4"],
    visible: Bool[Array, "C N"],
    camera_model: CameraModelName = "pinhole",
) -> Float[Array, "C N 3"]:
    """Unit normals of N Gaussians in C camera frames (OpenCV axes), facing the camera.

    Args:
        means: World positions; they only decide the sign.
        quats: Rotations (w, x, y, z) of any length.
        scales: They only decide which axis is the smallest.
        viewmats: World to camera.
        visible: Where it is False the normal is zero, with zero gradient, whatever the Gaussian holds.
        camera_model: Decides which way a Gaussian is seen from, and so the sign. Static.

    Returns:
        Normals, differentiable to quats and viewmats.
    """
    # What no camera sees is made harmless first; what one camera sees is sound.
    in_any_view = visible.any(0)[:, None]
    quats = jnp.where(in_any_view, quats, jnp.array([1, 0, 0, 0], quats.dtype))
    means = jax.lax.stop_gradient(jnp.where(in_any_view, means, 0))
    smallest = jnp.argmin(jnp.where(in_any_view, scales, 1), axis=-1)
    axis = [
        jnp.where(smallest == 0, x, jnp.where(smallest == 1, y, z)) for x, y, z in rotation(components(quats[None]))
    ]
    viewmat = [[entry[:, None] for entry in row] for row in matrix_rows(viewmats)]
    in_camera = [dot(viewmat[i], axis) for i in range(3)]
    ray = CAMERA_MODELS[camera_model].ray(camera_position(components(means[None]), viewmat))
    away = jax.lax.stop_gradient(dot(in_camera, ray)) > 0
    return jnp.stack([jnp.where(visible, jnp.where(away, -part, part), 0) for part in in_camera], -1)
