"""Guards that make an input safe before it is used, each with its value and gradient at the bad point; products."""

import jax
import jax.numpy as jnp
from jax import Array


def safe_normalize(v: Array, eps: float = 1e-12) -> Array:
    """Unit vectors along the last axis. Where the squared length is under `eps` the value and gradient are zero."""
    squared = dot(v, v)[..., None]
    usable = squared > eps
    return jnp.where(usable, v * jax.lax.rsqrt(jnp.where(usable, squared, 1)), 0)


def safe_divide(numerator: Array, denominator: Array, usable: Array) -> Array:
    """Quotient where `usable`, else zero with zero gradient."""
    return jnp.where(usable, numerator / jnp.where(usable, denominator, 1), 0)


def masked_mean(values: Array, mask: Array) -> Array:
    """Mean over the elements where `mask` (bool or weight of the same shape) counts; zero if none does."""
    weight = mask.astype(values.dtype)
    return jnp.sum(values * weight) / jnp.maximum(jnp.sum(weight), 1)


def dot(a: Array, b: Array) -> Array:
    """`[...]` products of `[..., D]` vectors of few numbers, written out.

    On a CPU, XLA hands a sum over an axis of three to a library, which takes several times as long.
    """
    return sum((a[..., i] * b[..., i] for i in range(1, a.shape[-1])), a[..., 0] * b[..., 0])


def mean_channel(values: Array) -> Array:
    """`[...]` means of `[..., D]` values of few channels, written out as in `dot`."""
    return dot(values, jnp.ones(values.shape[-1], values.dtype)) / values.shape[-1]


def times(matrix: Array, vector: Array) -> Array:
    """`[3]` product of `[3, 3]` and `[3]`, written out as in `dot`, for `jax.vmap` over many vectors.

    Matrix units of a GPU would round.
    """
    x, y, z = vector
    return jnp.stack([row[0] * x + row[1] * y + row[2] * z for row in matrix])
