"""One Adam per field of the Gaussians, with the learning rates of 3DGS."""

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jax import Array

from gsjax.gaussians import Gaussians
from gsjax.settings import MEANS_FINAL, Rates

LABELS = Gaussians(
    means="means", quats="quats", log_scales="scales", logit_opacities="opacities", sh_dc="sh_dc", sh_rest="sh_rest"
)


def labels(gaussians: Any) -> Gaussians:
    """`LABELS` in the structure of these Gaussians; optax also asks with a placeholder in their stead."""
    return replace(LABELS, pixel_filter=getattr(gaussians, "pixel_filter", LABELS.pixel_filter))


@lru_cache(maxsize=16)  # Programs are kept by it: the same rates shall be the same key.
def make_optimizer(
    rates: Rates, extent: float, decay_steps: int, *, views_per_step: int = 1
) -> optax.GradientTransformation:
    """Adam (0.9, 0.999, eps 1e-15) per field; the rate of the means falls log-linearly to `MEANS_FINAL`.

    The other rates stay, or fall to `rates.final_share` of themselves in the last third.

    Args:
        rates: Per field; those of the means are times `extent`.
        extent: Camera extent, scene units.
        decay_steps: Optimiser steps over which rates fall.
        views_per_step: Photos that a step takes: moments forget as much a photo, whatever that is.

    Returns:
        An optax transformation over `Gaussians`.
    """
    final = math.sqrt(views_per_step) * MEANS_FINAL
    schedule = optax.exponential_decay(
        rates.means * extent, max(decay_steps, 1), final / rates.means, end_value=final * extent
    )

    def falling(rate: float):
        return falling_at_last(rate, rates.final_share, decay_steps)

    def adam(rate):
        return optax.adam(rate, 0.9**views_per_step, 0.999**views_per_step, eps=1e-15)

    return optax.partition(
        {
            "means": adam(schedule),
            "quats": adam(falling(rates.quats)),
            "scales": adam(falling(rates.scales)),
            "opacities": adam(falling(rates.opacities)),
            "sh_dc": adam(falling(rates.sh_dc)),
            "sh_rest": adam(falling(rates.sh_rest)),
        },
        labels,
    )


def falling_at_last(rate: float, final_share: float, steps: int) -> float | optax.Schedule:
    """A rate that falls log-linearly to `final_share` of itself in the last third of the steps; 1: it stays."""
    if final_share == 1:
        return rate
    last = max(steps // 3, 1)
    begin, end_value = max(steps - last, 0), rate * final_share
    return optax.exponential_decay(rate, last, final_share, transition_begin=begin, end_value=end_value)


def apply_gradients(
    optimizer: optax.GradientTransformation, gaussians: Gaussians, state: Any, gradients: Gaussians
) -> tuple[Gaussians, Any]:
    """One optimiser step."""
    # optax mixes int32 counts with floats, which strict promotion forbids.
    with jax.numpy_dtype_promotion("standard"):
        updates, state = optimizer.update(gradients, state, gaussians)
    return jax.tree.map(jnp.add, gaussians, updates), state


def map_moments(optimizer: optax.GradientTransformation, f, state: Any) -> Any:
    """Apply `f` to every moment array of an optimiser state (leading axis: Gaussians) and to nothing else."""
    return optax.tree.map_params(optimizer, f, state)


def rearrange_moments(optimizer: optax.GradientTransformation, state: Any, source: Array, fresh: Array) -> Any:
    """Moments follow their Gaussian: row i takes those of row `source[i]`, or zero where `fresh[i]`.

    Args:
        optimizer: The transformation that made `state`.
        state: Its state.
        source: `[N]` int32.
        fresh: `[N]` bool.

    Returns:
        The state; counts and schedules are untouched.
    """

    def rearranged(moment):
        keep = (~fresh).reshape(-1, *[1] * (moment.ndim - 1))
        return jnp.where(keep, moment[source], 0)

    return map_moments(optimizer, rearranged, state)
