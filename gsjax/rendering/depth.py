"""What the splats of one view say about depth: the channels that are composited for it, and how they are read."""

from typing import Literal

import jax.numpy as jnp
from jax import Array

import rasterizer
from gsjax.numerics import safe_divide
from gsjax.rendering.splats import Splats, features
from rasterizer import DepthMode

DepthReading = Literal["center", "plane", "front", "discs"]
"""What a pixel's depth is: the mean of its splats', each as `rasterizer.DepthMode` has it; or the mean of the planes of
those in front, see `IN_FRONT`."""

IN_FRONT: dict[str | None, rasterizer.Front] = {
    "front": rasterizer.Front(channels=4, stop_after=0.2),
    "discs": rasterizer.Front(channels=4, stop_after=0.4),
}
"""Planes and what they cover, down to some of the light: what shines through the first layers from far behind is a few
hundredths of the light, but not of its depth. More shines through discs on a mesh, of its far side."""

MIN_COVERAGE = 0.5  # A pixel covered less has no surface whose depth would mean anything (method: A10, A11).


def splat_depth_mode(reading: DepthReading | None) -> DepthMode:
    """What depth splats are projected with to be read so; None: depth is not read."""
    return "center" if reading in (None, "center") else "plane"


def depth_channels(splats: Splats, reading: DepthReading) -> Array:
    """`[N, D]` values that `summed_depth` reads once they are composited."""
    planes = rasterizer.depth_channels(splats.projection, splats.grid.width, splats.grid.height)[0]
    return jnp.concatenate([planes, jnp.ones_like(planes[:, :1])], -1) if reading in IN_FRONT else planes


def summed_depth(composited: Array, alphas: Array, reading: DepthReading) -> tuple[Array, Array]:
    """`[H, W]` depths times weights, summed, of composited `depth_channels` `[H, W, D]`; and the summed weights."""
    if reading in IN_FRONT:
        composited, alphas = composited[..., :-1], composited[..., -1]
    return rasterizer.blended_depth(composited[None])[0, ..., 0], alphas


def mean_depth(summed: Array, weights: Array) -> Array:
    """`[H, W]` depth of both results of `summed_depth`; 0 where less than `MIN_COVERAGE` is covered."""
    return safe_divide(summed, weights, weights > MIN_COVERAGE)


def expected_depth(splats: Splats, reading: DepthReading = "plane") -> tuple[Array, Array]:
    """`[H, W]` depth and `[H, W]` alphas, as `gsjax.rendering` has them, without colours: a pass of its own."""
    image, alphas = features(splats, depth_channels(splats, reading), IN_FRONT.get(reading))
    return mean_depth(*summed_depth(image, alphas, reading)), alphas
