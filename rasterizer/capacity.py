"""How long the buffer of (tile, splat) pairs must be: counted before the image is rendered, in buckets."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from rasterizer.binning import TileGrid, count_pairs
from rasterizer.ewa import Projection
from rasterizer.projection import project
from rasterizer.rules import Rules


class UnknownCountError(ValueError):
    """The number of pairs is not known while a program is compiled."""


@jax.custom_batching.custom_vmap
def _largest(count: Array) -> Array:
    """The count itself; under `vmap`, the largest of the batch, unbatched; under several, of them all."""
    return count


@_largest.def_vmap
def _largest_of_batch(axis_size, in_batched, count):
    del axis_size, in_batched
    return _largest(jnp.max(count)), False


def capacity_bucket(needed: int) -> int:
    """The next power of two, or the one and a half times a power of two, that holds `needed` pairs.

    Raises:
        ValueError: If `needed` is the largest int32, which means "does not fit".
    """
    if needed >= np.iinfo(np.int32).max:
        raise ValueError(f"{needed} or more (tile, Gaussian) pairs do not fit 32-bit indices: render fewer or smaller")
    power = 1 << max(needed - 1, 255).bit_length()
    return power * 3 // 4 if needed <= power * 3 // 4 else power


def count_capacity(projection: Projection, grid: TileGrid) -> int:
    """The bucket for a projection; under `vmap`, the largest of the batch.

    Raises:
        UnknownCountError: Inside `jit`, where the number of pairs is not known.
    """
    return _bucket_of(_largest(count_pairs(jax.lax.stop_gradient(projection), grid)))


def _bucket_of(count: Array) -> int:
    try:
        return capacity_bucket(int(count))
    except jax.errors.ConcretizationTypeError:
        raise UnknownCountError(
            "inside jit the number of (tile, Gaussian) pairs is not known: pass capacity=..., "
            "check info['overflowed'], and retry with at least info['needed']"
        ) from None


Shapes = tuple[Array, Array | None, Array | None, Array, Array, Array]
"""Means, quats, scales, opacities, viewmats and Ks, as `project` takes them."""


@partial(jax.jit, static_argnames=("grid", "options", "rules"))
def _count(shapes: Shapes, named_arrays: dict, grid: TileGrid, options: tuple, rules: Rules) -> Array:
    projection = project(*shapes, grid.width, grid.height, **named_arrays, **dict(options), rules=rules)
    return count_pairs(projection, grid)


def choose_capacity(
    shapes: Shapes,
    named_arrays: dict[str, Array | None],
    grid: TileGrid,
    options: tuple[tuple[str, Any], ...],
    rules: Rules,
) -> int:
    """The bucket for this scene and these cameras; under `vmap`, the largest of the batch.

    `named_arrays` and `options`, `(name, value)` each, are the other arguments of `project`.

    Raises:
        UnknownCountError: Inside `jit`, where the number of pairs is not known.
    """
    shapes, named_arrays = jax.lax.stop_gradient((shapes, named_arrays))
    return _bucket_of(_largest(_count(shapes, named_arrays, grid, options, rules)))
