"""What the splats of one view say about depth, composited in a pass of its own."""

import jax.numpy as jnp
import numpy as np
from jax import Array

import rasterizer
from gsjax.numerics import safe_divide
from gsjax.render import MIN_COVERAGE, Splats, features


def expected_depth(splats: Splats) -> tuple[Array, Array]:
    """`[H, W]` expected depth and `[H, W]` alphas, as `gsjax.render.view` has them, without colours."""
    image, alphas = features(splats, _planes(splats))
    return safe_divide(_read(image), alphas, alphas > MIN_COVERAGE), alphas


def depth_moments(splats: Splats, center: Array) -> tuple[Array, Array]:
    """`[H, W]` sums over every pixel's splats of weight times (z - center), and of weight times (z - center)^2.

    z is a splat's depth at the pixel, on its plane where the splats have slopes, else its mean's. A square of planes is
    no plane, but is composited by its coefficients all the same: six channels more, and no kernel knows of it.

    Args:
        splats: The view, with slopes or without (`gsjax.render.splat`).
        center: `[]` scene units, near the depths that matter: float32 keeps seven digits of what is left of z.

    Returns:
        Both sums, scene units and their square; differentiable to the splats.
    """
    planes = _planes(splats).at[:, 0].add(-center)
    count = planes.shape[1]
    row, column = np.triu_indices(count)
    image, _ = features(splats, jnp.concatenate([planes, planes[:, row] * planes[:, column]], -1))
    products = np.zeros((count, count), np.int32)
    products[row, column] = products[column, row] = count + np.arange(len(row))
    return _read(image[..., :count]), _read(jnp.stack([_read(image[..., line]) for line in products], -1))


def _planes(splats: Splats) -> Array:
    """`[N, 1]` or `[N, 3]` channels that `_read` reads."""
    return rasterizer.depth_channels(splats.projection, splats.grid.width, splats.grid.height)[0]


def _read(channels: Array) -> Array:
    """`[H, W]` what composited depth channels are at each pixel."""
    return rasterizer.blended_depth(channels[None])[0, ..., 0]
