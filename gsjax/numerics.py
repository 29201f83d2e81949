"""Guards that make an input safe before it is used, each with its value and gradient at the bad point; a product."""

import jax
import jax.numpy as jnp
from jax import Array


def safe_normalize(v: Array, eps: float = 1e-12) -> Array:
    """Unit vectors along the last axis. Where the squared length is under `eps` the value and gradient are zero."""
    squared = jnp.sum(v * v, axis=-1, keepdims=True)
    usable = squared > eps
    return jnp.where(usable, v * jax.lax.rsqrt(jnp.where(usable, squared, 1)), 0)


def safe_divide(numerator: Array, denominator: Array, usable: Array) -> Array:
    """Quotient where `usable`, else zero with zero gradient."""
    return jnp.where(usable, numerator / jnp.where(usable, denominator, 1), 0)


def masked_mean(values: Array, mask: Array) -> Array:
    """Mean over the elements where `mask` (bool or weight of the same shape) counts; zero if none does."""
    weight = mask.astype(values.dtype)
    return jnp.sum(values * weight) / jnp.maximum(jnp.sum(weight), 1)


def times(matrix: Array, vector: Array) -> Array:
    """`[3]` product of `[3, 3]` and `[3]`, written out, for `jax.vmap` over many vectors.

    A sum over an axis of three would be slow on a CPU, where XLA hands it to a library that reads the matrix anew for
    every vector, and matrix units of a GPU would round.
    """
    x, y, z = vector
    return jnp.stack([row[0] * x + row[1] * y + row[2] * z for row in matrix])
