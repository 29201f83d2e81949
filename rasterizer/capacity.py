"""How long the buffer of (tile, splat) pairs must be: counted before the image is rendered, in buckets."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from rasterizer.binning import TileGrid, count_pairs
from rasterizer.projection import project


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
        ValueError: If `needed` is the largest int32, which stands for "does not fit".
    """
    if needed >= np.iinfo(np.int32).max:
        raise ValueError(f"{needed} or more (tile, Gaussian) pairs do not fit 32-bit indices: render fewer or smaller")
    power = 1 << max(needed - 1, 255).bit_length()
    return power * 3 // 4 if needed <= power * 3 // 4 else power


@partial(jax.jit, static_argnames=("grid", "eps2d", "near_plane", "far_plane", "rasterize_mode", "rules"))
def _count(means, quats, scales, opacities, viewmats, Ks, covars, grid, **options):
    gaussians = means, quats, scales, opacities
    projection = project(*gaussians, viewmats, Ks, grid.width, grid.height, covars=covars, **options)
    return count_pairs(projection, grid)


def choose_capacity(means, quats, scales, opacities, viewmats, Ks, covars, grid: TileGrid, options: dict) -> int:
    """The bucket for this scene and these cameras; under `vmap`, the largest of the batch.

    Raises:
        ValueError: Inside `jit`, where the number of pairs is not known.
    """
    arrays = jax.lax.stop_gradient((means, quats, scales, opacities, viewmats, Ks, covars))
    count = _count(*arrays, grid, **options)
    try:
        return capacity_bucket(int(_largest(count)))
    except jax.errors.ConcretizationTypeError:
        raise ValueError(
            "inside jit the number of (tile, Gaussian) pairs is not known: pass capacity=..., "
            "check info['overflowed'], and retry with at least info['needed']"
        ) from None
