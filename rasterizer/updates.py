"""What follows the gradients: whether they are finite, and one step of Adam. Native loops on a CPU, jnp elsewhere."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from rasterizer.engines import Backend, native_loops


class Moments(NamedTuple):
    """Adam's two averages, arrays like the parameters."""

    mu: Float[Array, "*shape"]  # of the gradients
    nu: Float[Array, "*shape"]  # of their squares


def all_finite(tree: Any, *, backend: Backend = "auto") -> Bool[Array, ""]:
    """Whether no number of a pytree is NaN or infinite. Not differentiable.

    Args:
        tree: Arrays and numbers of any kind; whole numbers are finite.
        backend: "native" is the loops of a CPU, for float32. Static.
    """
    leaves = [leaf for leaf in map(jnp.asarray, jax.tree.leaves(tree)) if jnp.issubdtype(leaf.dtype, jnp.inexact)]
    loops = native_loops(backend)
    in_loops = [leaf for leaf in leaves if loops and leaf.dtype == jnp.float32]
    others = [jnp.all(jnp.isfinite(leaf)) for leaf in leaves if not loops or leaf.dtype != jnp.float32]
    if loops and in_loops:
        others.append(loops.call("all_finite", jax.ShapeDtypeStruct((), bool), *in_loops))
    return jnp.all(jnp.stack(others)) if others else jnp.bool_(True)


def adam(
    parameters: Float[Array, "*shape"],
    gradients: Float[Array, "*shape"],
    moments: Moments,
    skipped: Bool[Array, ""],
    *,
    rate: Float[Array, ""] | float,
    count: Int[Array, ""],
    b1: float = 0.9,
    b2: float = 0.999,
    eps: float = 1e-15,
    backend: Backend = "auto",
) -> tuple[Float[Array, "*shape"], Moments]:
    """The parameters and moments after a step, those of `optax.adam` to a unit in the last place.

    Where parameters and moments are donated, or used for nothing else, the native loops write over them.

    Args:
        parameters: Float32 (others are updated in jnp).
        gradients: Finite unless the step is skipped.
        moments: After the step before; zeros in the beginning.
        skipped: Nothing changes where it is True.
        rate: Learning rate of this step.
        count: Number of this step, from 1.
        b1: Share of `mu` that stays. Static.
        b2: Share of `nu` that stays. Static.
        eps: Added to the root of `nu`. Static.
        backend: "native" is the loops of a CPU. Static.

    Returns:
        Not differentiable.
    """
    steps = count.astype(jnp.float32)
    numbers = rate, b1, 1 - b1, b2, 1 - b2, 1 - b1**steps, 1 - b2**steps, eps
    loops = native_loops(backend)
    if loops and parameters.dtype == jnp.float32:
        packed = jnp.stack([jnp.asarray(number, jnp.float32) for number in numbers])
        arguments = parameters, gradients, *moments, packed, skipped
        in_place = {0: 0, 2: 1, 3: 2}
        parameters, *moved = loops.call("adam", [parameters] * 3, *arguments, input_output_aliases=in_place)
        return parameters, Moments(*moved)
    mu = b1 * moments.mu + (1 - b1) * gradients
    nu = b2 * moments.nu + (1 - b2) * (gradients * gradients)
    after = parameters - rate * (mu / (1 - b1**steps)) / (jnp.sqrt(nu / (1 - b2**steps)) + eps)
    old, new = (parameters, moments), (after, Moments(mu, nu))
    return jax.tree.map(lambda before, after: jnp.where(skipped, before, after), old, new)
