"""The splats that show, brought together: gsplat's packed results of a projection."""

from math import prod
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array


def pack_rows(shown: Array, parts: tuple[Array | None, ...], capacity: int | None) -> tuple[Any, ...]:
    """Rows of what shows, in the order of batch, camera and Gaussian.

    Args:
        shown: `[..., C, N]` bool.
        parts: `[..., C, N, *]` each, or None.
        capacity: n, the length of the rows. None counts on the host, which `jit` cannot.

    Returns:
        int32 indices of batch, camera and Gaussian `[n]`, -1 in a slot left over; `[B * C + 1]` int32, where each
        image's rows begin, and last how many rows are needed; then the parts `[n, *]`, zero in a slot left over.

    Raises:
        ValueError: Inside `jit` without a capacity.
    """
    shown = jax.lax.stop_gradient(shown)
    *images, num_gaussians = shown.shape
    counts = shown.reshape(prod(images), num_gaussians).sum(-1, dtype=jnp.int32)
    indptr = jnp.concatenate([jnp.zeros(1, jnp.int32), jnp.cumsum(counts, dtype=jnp.int32)])
    if capacity is None:
        try:
            capacity = int(indptr[-1])
        except jax.errors.ConcretizationTypeError:
            raise ValueError("inside jit the number of packed rows is not known: pass capacity=...") from None
    (rows,) = jnp.nonzero(shown.reshape(-1), size=capacity, fill_value=shown.size)
    image, gaussian = jnp.divmod(rows.astype(jnp.int32), max(num_gaussians, 1))
    batch, camera = jnp.divmod(image, images[-1])
    ids = (jnp.where(rows < shown.size, index, -1) for index in (batch, camera, gaussian))

    def packed(part: Array) -> Array:
        flat = part.reshape(shown.size, *part.shape[shown.ndim :])
        return flat.at[rows].get(mode="fill", fill_value=0)

    return *ids, indptr, *(None if part is None else packed(part) for part in parts)
