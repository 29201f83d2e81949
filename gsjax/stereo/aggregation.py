"""Smooth depth from dissimilarities: semi-global matching (Hirschmüller, PAMI 2008)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

STEP = 0.1  # cost of a neighbour at the next plane, in dissimilarities
JUMP = 1.0  # cost of a neighbour at any other plane


class Planes(NamedTuple):
    """The plane of every pixel."""

    places: np.ndarray  # [H, W] float32, in planes from the first
    unlike: np.ndarray  # [H, W] float32, dissimilarity at the nearest plane


def best_planes(dissimilarities: np.ndarray) -> Planes:
    """Return the plane of every pixel, interpolated between planes by a parabola.

    Args:
        dissimilarities: `[D, H, W]` float32, D at least 3.
    """
    return Planes(*map(np.asarray, _best_planes(jnp.asarray(dissimilarities))))


@jax.jit
def _best_planes(costs: Array) -> tuple[Array, Array]:
    smooth = smoothed(jnp.moveaxis(costs, 0, -1))
    plane = jnp.argmin(smooth, axis=-1)
    inner = jnp.clip(plane, 1, smooth.shape[-1] - 2)
    before, here, after = (
        jnp.take_along_axis(smooth, (inner + step)[..., None], axis=-1)[..., 0] for step in (-1, 0, 1)
    )
    bend = before - 2 * here + after
    vertex = jnp.clip((before - after) / jnp.where(bend > 0, 2 * bend, 1), -0.5, 0.5)
    places = plane.astype(smooth.dtype) + jnp.where((bend > 0) & (plane == inner), vertex, 0)
    return places, jnp.take_along_axis(costs, plane[None], axis=0)[0]


def smoothed(costs: Array) -> Array:
    """Return `[H, W, D]` the sum of costs of the best paths that reach a pixel from four sides, at every plane."""
    across = costs.swapaxes(0, 1)
    down = _along(costs) + _along(costs[::-1])[::-1]
    return down + (_along(across) + _along(across[::-1])[::-1]).swapaxes(0, 1)


def _along(costs: Array) -> Array:
    """Return `[L, N, D]` costs along N paths of L pixels, from the first to the last."""

    def step(before: Array, cost: Array) -> tuple[Array, Array]:
        least = jnp.min(before, axis=-1, keepdims=True)
        padded = jnp.pad(before, ((0, 0), (1, 1)), constant_values=jnp.inf)
        beside = jnp.minimum(padded[:, :-2], padded[:, 2:]) + STEP
        # Minus the least cost before, so that costs do not grow along a path.
        now = cost + jnp.minimum(jnp.minimum(before, beside), least + JUMP) - least
        return now, now

    return jax.lax.scan(step, jnp.zeros(costs.shape[1:], costs.dtype), costs)[1]
