"""What is behind all Gaussians: one colour, or one for every direction that is looked in."""

import jax.numpy as jnp
import numpy as np
from jax import Array

import rasterizer
from gsjax.gaussians import SH_C0
from gsjax.scene.cameras import Camera, pixel_rays, rotation

RIDGE = 1e-3


def color_behind(background: Array, camera: Camera) -> Array:
    """`[3]` or `[H, W, 3]`: what a camera sees where nothing is in front, for the background of a render.

    The background is a colour `[3]`; or `[(L + 1)^2, 3]` SH coefficients of a colour max(0, SH(direction) + 0.5) of the
    ray's direction in the world, L at most 4. Differentiable to both arguments.
    """
    if background.ndim == 1:
        return background
    degree = round(len(background) ** 0.5) - 1
    if degree == 0:
        return jnp.maximum(SH_C0 * background[0] + 0.5, 0)
    directions = jnp.sum(pixel_rays(camera)[..., None] * rotation(camera)[None, None], axis=-2)
    return jnp.maximum(rasterizer.spherical_harmonics(degree, directions, background[None, None]) + 0.5, 0)


def fitted_coefficients(directions: np.ndarray, colors: np.ndarray, degree: int) -> np.ndarray:
    """`[(degree + 1)^2, 3]` float32 coefficients that come nearest to colours `[R, 3]` seen along `[R, 3]` directions.

    Without a direction they stay at the mean colour: all but the first weigh `RIDGE` of their squares.
    """
    count = (degree + 1) ** 2
    one_by_one = jnp.eye(count, dtype=jnp.float32)[None]
    basis = np.asarray(rasterizer.spherical_harmonics(degree, jnp.asarray(directions, jnp.float32), one_by_one))
    mean = colors.mean(0)
    weights = basis.T @ basis / len(basis) + RIDGE * np.eye(count)
    fitted = np.linalg.solve(weights, basis.T @ (colors - mean) / len(basis))
    return constant_coefficients(mean, degree) + fitted.astype(np.float32)


def constant_coefficients(color: np.ndarray, degree: int) -> np.ndarray:
    """`[(degree + 1)^2, 3]` float32 coefficients of one colour `[3]` in all directions."""
    coefficients = np.zeros(((degree + 1) ** 2, 3), np.float32)
    coefficients[0] = (color - 0.5) / SH_C0
    return coefficients
