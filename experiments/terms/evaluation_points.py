"""Where in space the gradient of a Gaussian is taken: functions of (Gaussians, Camera, Kept).

At the mean is what the paper prints. There the density's gradient has nothing of the Gaussian itself and, on a plane of
them, lies in the plane; a step off the mean gives it a side.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from gsjax import cameras
from gsjax.cameras import Camera
from gsjax.gaussians import Gaussians, rotation_matrices, scales, smallest_axes
from gsjax.normals.sdf import face_camera
from gsjax.training.terms import Kept

EvaluationPoints = Callable[[Gaussians, Camera, Kept | None], Array]
"""(Gaussians, Camera, what the term keeps) -> `[N, 3]` world positions."""

SPREAD = 1.5  # standard deviations of the points drawn about a Gaussian, in its own (SuGaR)


def centers(gaussians: Gaussians, camera: Camera, kept: Kept | None = None) -> Array:
    """The means."""
    del camera, kept
    return gaussians.means


def before(gaussians: Gaussians, camera: Camera, kept: Kept | None = None, *, deviations: float = 1.0) -> Array:
    """So many of the smallest standard deviations from the mean, along the smallest axis, on the camera's side.

    Differentiable to means, rotations and scales; not through which side it is.
    """
    del kept
    normals = face_camera(smallest_axes(gaussians), cameras.center(camera)[None] - gaussians.means)
    return gaussians.means + deviations * scales(gaussians).min(-1, keepdims=True) * normals


def random_points(gaussians: Gaussians, camera: Camera, kept: Kept | None) -> Array:
    """One point of each Gaussian, drawn anew in every step: normal about the mean, `SPREAD` times as wide as it is."""
    del camera
    assert kept is not None, "points are drawn with the step's key"
    noise = jax.random.normal(kept.key, gaussians.means.shape, gaussians.means.dtype)
    return gaussians.means + SPREAD * rotate(rotation_matrices(gaussians.quats), noise * scales(gaussians))


def rotate(rotations: Array, vectors: Array) -> Array:
    """`[..., 3]` vectors turned by `[..., 3, 3]` rotations."""
    return jnp.sum(rotations * vectors[..., None, :], axis=-1)
