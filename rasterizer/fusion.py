"""What keeps XLA from fusing one computation into another."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from rasterizer.devices import default_device
from rasterizer.manual_axes import vary_like

T = TypeVar("T")


def walled(function: Callable[..., T], is_wanted: Array, *inputs: Any) -> T:
    """The function's value behind a wall to XLA's fusion where that helps, on a CPU; zeros where it is not wanted.

    A branch is such a wall. Without it the stacking of components is fused into their computation, and the derivative
    takes ten times as long on a CPU. A GPU would wait for the host to take the branch.
    """
    if default_device().platform != "cpu":
        return function(*inputs)
    nothing = jax.eval_shape(function, *inputs)
    zeros = jax.tree.map(lambda part: vary_like(jnp.zeros(part.shape, part.dtype), inputs), nothing)
    return jax.lax.cond(is_wanted, function, lambda *_: zeros, *inputs)
