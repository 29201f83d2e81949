"""One Adam per field of the Gaussians, with the learning rates of 3DGS."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple, Protocol, TypeVar

import jax
import jax.numpy as jnp
import optax
from jax import Array

import rasterizer
from gsjax.gaussians import Gaussians
from gsjax.settings import COLOR_RATE, MEANS_FINAL, OPACITY_RATE, Rates
from rasterizer import Moments

P = TypeVar("P")  # parameters: a pytree of arrays

Rate = float | optax.Schedule  # a schedule: steps that were done before -> rate


class Optimizer(Protocol):
    """What `optax.GradientTransformation` has: any optax optimizer is one."""

    init: Callable[..., Any]
    update: Callable[..., Any]


class AdamState(NamedTuple):
    """The averages of `Adam`, trees like the parameters."""

    count: Array  # [] int32 steps done
    mu: Any  # of the gradients
    nu: Any  # of their squares


@dataclass(frozen=True)
class Adam:
    """`optax.adam` (eps 1e-15) with a learning rate for each field, in one pass over memory on a CPU."""

    rates: Mapping[str, Rate] = field(hash=False)  # by the path of the field: "means", "free.means"
    b1: float = 0.9
    b2: float = 0.999

    def init(self, parameters: Any) -> AdamState:
        """Zeros."""
        zeros = jax.tree.map(jnp.zeros_like, parameters)
        return AdamState(jnp.zeros((), jnp.int32), zeros, jax.tree.map(jnp.zeros_like, parameters))

    def update(self, gradients: Any, state: AdamState, parameters: Any = None) -> tuple[Any, AdamState]:
        """What optax requires: the change of the parameters, and the next state."""
        zeros = jax.tree.map(jnp.zeros_like, gradients if parameters is None else parameters)
        return self.step(zeros, gradients, state, jnp.zeros((), bool))

    def step(self, parameters: Any, gradients: Any, state: AdamState, skipped: Array) -> tuple[Any, AdamState]:
        """The parameters and the state after a step; as they were where `skipped`, a `[]` bool."""
        count = optax.safe_increment(state.count)

        def step_field(path, parameter: Array, gradient: Array, mu: Array, nu: Array) -> tuple[Array, Moments]:
            rate = self.rates[jax.tree_util.keystr(path, simple=True, separator=".")]
            rate = rate(state.count) if callable(rate) else rate
            how = {"rate": rate, "count": count, "b1": self.b1, "b2": self.b2}
            return rasterizer.adam(parameter, gradient, Moments(mu, nu), skipped, **how)

        # optax mixes int32 counts with floats, which strict promotion forbids.
        with jax.numpy_dtype_promotion("standard"):
            fields = jax.tree_util.tree_map_with_path(step_field, parameters, gradients, state.mu, state.nu)
        one_field = jax.tree.structure((0, Moments(0, 0)))
        moved, moments = jax.tree.transpose(jax.tree.structure(parameters), one_field, fields)
        return moved, AdamState(jnp.where(skipped, state.count, count), *moments)


@lru_cache(maxsize=16)  # Programs are kept by it: the same rates shall be the same key.
def make_optimizer(
    rates: Rates, extent: float, decay_steps: int, *, views_per_step: int = 1, color_rate: float = COLOR_RATE
) -> Adam:
    """Adam (0.9, 0.999) per field of `Gaussians`; the rate of the means falls log-linearly to `MEANS_FINAL`.

    The other rates stay, or fall to `rates.final_share` of themselves in the last third of `decay_steps`. The means'
    are times the camera extent, scene units. Moments forget as much a photo, whatever a step has of them.
    """
    root = math.sqrt(views_per_step)
    final = root * MEANS_FINAL
    of_means = optax.exponential_decay(
        rates.means * extent, max(decay_steps, 1), final / rates.means, end_value=final * extent
    )
    others = {
        "quats": rates.quats,
        "log_scales": rates.scales,
        "logit_opacities": root * OPACITY_RATE,
        "sh_dc": root * color_rate,
        "sh_rest": rates.sh_rest,
    }
    of_others = {name: falling_at_last(rate, rates.final_share, decay_steps) for name, rate in others.items()}
    return Adam({"means": of_means, **of_others}, 0.9**views_per_step, 0.999**views_per_step)


def falling_at_last(rate: float, final_share: float, steps: int) -> Rate:
    """A rate that falls log-linearly to `final_share` of itself in the last third of the steps; 1: it stays."""
    if final_share == 1:
        return rate
    last = max(steps // 3, 1)
    begin, end_value = max(steps - last, 0), rate * final_share
    return optax.exponential_decay(rate, last, final_share, transition_begin=begin, end_value=end_value)


def apply_gradients(parameters: P, state: Any, optimizer: Optimizer, gradients: P, skipped: Array) -> tuple[P, Any]:
    """One optimiser step; parameters and state as they were where `skipped`, a `[]` bool."""
    if isinstance(optimizer, Adam):
        return optimizer.step(parameters, gradients, state, skipped)
    # optax mixes int32 counts with floats, which strict promotion forbids.
    with jax.numpy_dtype_promotion("standard"):
        updates, moved = optimizer.update(gradients, state, parameters)
    return unless(skipped, (parameters, state), (jax.tree.map(jnp.add, parameters, updates), moved))


def unless(skipped: Array, before: P, after: P) -> P:
    """One tree where `skipped`, a `[]` bool, the other elsewhere."""
    return jax.tree.map(lambda old, new: jnp.where(skipped, old, new), before, after)


def zero_moments(opt_state: Any, *fields: str) -> Any:
    """Zero the moments of fields of `Gaussians`, such as "logit_opacities", in the state of `adam` or any of optax.

    A field that was set by hand keeps the moments of its former values otherwise. May be called inside `jit`.

    Raises:
        ValueError: `Gaussians` has no such field.
    """
    arrays = sorted(each.name for each in dataclasses.fields(Gaussians) if not each.metadata.get("static"))
    for name in fields:
        if name not in arrays:
            raise ValueError(f"field {name!r} is none of {', '.join(arrays)}")

    def without(moments: Any) -> Any:
        if not isinstance(moments, Gaussians):
            return moments
        return replace(moments, **{name: jax.tree.map(jnp.zeros_like, getattr(moments, name)) for name in fields})

    return jax.tree.map(without, opt_state, is_leaf=lambda node: isinstance(node, Gaussians))


def rearrange_moments(state: Any, optimizer: Optimizer, source: Array, fresh: Array) -> Any:
    """Moments follow their Gaussian: row i has those of row `source[i]` (`[N]` int32), or zero where `fresh[i]`."""

    def rearranged(moment):
        keep = (~fresh).reshape(-1, *[1] * (moment.ndim - 1))
        return jnp.where(keep, moment[source], 0)

    return optax.tree.map_params(optimizer, rearranged, state)
