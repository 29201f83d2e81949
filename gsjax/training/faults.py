"""What is wrong with a step that is not finite: examined only after it, one term of the loss at a time."""

from collections.abc import Callable, Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax.scene.batches import Batch, Batches
from gsjax.training.step import Metrics

NOT_FINITE = "the loss or a gradient is not finite"


def faulty_terms(
    names: Iterable[str],
    step_of: Callable[[str], Callable[[Any, Batch, Array], tuple[Any, Metrics]]],
    state: Any,
    target: Batch,
    key: Array,
) -> str:
    """Which of these terms are at fault, in words, by the step of each alone. The state before it stays as it is."""
    faults = []
    for name in names:
        _, metrics = step_of(name)(jax.tree.map(jnp.copy, state), target, key)
        value = float(metrics.terms[name])
        if not np.isfinite(value):
            faults.append(f"the loss term '{name}' is {value}")
        elif not metrics.finite:
            faults.append(f"the gradient of the loss term '{name}' is not finite")
    return " and ".join(faults) or f"{NOT_FINITE}, though that of every term alone is"


def photo_of(data: Batches, view: int) -> str:
    """A photo by its name, or by its number."""
    return f"photo {data.names[view] if data.names else view}"
