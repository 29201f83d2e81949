"""What is blended: the channels that a call asks for, and none besides."""

from typing import Literal

import jax.numpy as jnp
from jax import Array

from rasterizer.harmonics import spherical_harmonics
from rasterizer.projection import Projection

RenderMode = Literal["RGB", "D", "ED", "RGB+D", "RGB+ED"]


def num_channels(colors: Array, render_mode: RenderMode) -> int:
    """Channels of the image."""
    return (colors.shape[-1] if "RGB" in render_mode else 0) + (render_mode != "RGB")


def drawable(colors: Array, sh_degree: int | None) -> Array:
    """`[N]` whether all of a Gaussian's colours are finite: one NaN would spread to every pixel that it touches."""
    gaussian_axis = 1 if colors.ndim == 3 and sh_degree is None else 0
    return jnp.isfinite(colors).all([axis for axis in range(colors.ndim) if axis != gaussian_axis])


def image_features(
    means: Array,
    colors: Array,
    viewmats: Array,
    projection: Projection,
    sh_degree: int | None,
    render_mode: RenderMode,
) -> Array:
    """`[C, N, X]` channels of the image: colours (from harmonics where asked) and, last, depth."""
    num_cameras = viewmats.shape[0]
    parts = []
    if "RGB" in render_mode:
        if sh_degree is not None:
            centers = -jnp.sum(viewmats[:, :3, :3] * viewmats[:, :3, 3, None], axis=1)
            values = spherical_harmonics(sh_degree, means[None] - centers[:, None], colors[None], projection.visible)
            parts.append(jnp.maximum(values + 0.5, 0))
        else:
            colors = colors if colors.ndim == 3 else jnp.broadcast_to(colors[None], (num_cameras, *colors.shape))
            parts.append(jnp.where(projection.visible[..., None], colors, 0))
    if render_mode != "RGB":
        parts.append(jnp.where(projection.visible, projection.depths, 0)[..., None])
    return jnp.concatenate(parts, -1)


def expected_depth(image: Array, alphas: Array) -> Array:
    """The image with its last channel divided by alpha: 0 at an empty pixel, without gradient."""
    covered = alphas > 0
    # The divisor is made safe first.
    depth = jnp.where(covered, image[..., -1:] / jnp.where(covered, alphas, 1), 0)
    return jnp.concatenate([image[..., :-1], depth], -1)


def median_depth(depths: Array, median: Array) -> Array:
    """`[C, H, W, 1]` depth of each pixel's median splat, 0 where there is none; differentiable to `depths` `[C, N]`."""
    if depths.size == 0:
        return jnp.zeros((*median.shape, 1), depths.dtype)
    return jnp.where(median >= 0, depths.reshape(-1)[jnp.maximum(median, 0)], 0)[..., None]
