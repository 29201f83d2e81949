"""How long the buffer of (tile, splat) pairs must be: counted before the image is rendered, in buckets."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from rasterizer.binning import TileGrid, count_pairs
from rasterizer.ewa import Projection


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


_count_pairs = jax.jit(count_pairs, static_argnames="grid")


def count_capacity(projection: Projection, grid: TileGrid) -> int:
    """The bucket for a projection; under `vmap`, the largest of the batch.

    Raises:
        UnknownCountError: Inside `jit`, where the number of pairs is not known.
    """
    count = _largest(_count_pairs(jax.lax.stop_gradient(projection), grid))
    try:
        return capacity_bucket(int(count))
    except jax.errors.ConcretizationTypeError:
        raise UnknownCountError(
            "inside jit the number of (tile, Gaussian) pairs is not known: pass capacity=..., "
            "check info['overflowed'], and retry with at least info['needed']"
        ) from None
