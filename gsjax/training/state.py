"""All that changes while training, and the changes that are not optimiser steps: densify, reset, cull."""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Int32

from gsjax.effects import simulation
from gsjax.effects.simulation import NO_EFFECTS, Effects, EffectState
from gsjax.gaussians import Gaussians, is_alive, opacities
from gsjax.settings import Density
from gsjax.training import optimizers
from gsjax.training.densification import gradient_driven
from gsjax.training.densification.rules import DENSIFICATION_RULES, DensificationRule
from gsjax.training.optimizers import Optimizer


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TrainState:
    """All that changes while training, and all that a checkpoint holds."""

    gaussians: Gaussians
    opt_state: Any
    statistics: Any  # [N] sums of the densification rule, see `gsjax.training.densification.rules`
    step: Int32[Array, ""]  # steps done
    effects: EffectState | None = None  # of those that are simulated
    # What `gsjax.densify` reads; a run's loop knows both itself.
    optimizer: Any = field(default=None, metadata={"static": True})
    densification: Any = field(default=None, metadata={"static": True})


def initial_state(
    gaussians: Gaussians,
    optimizer: Optimizer,
    rule: DensificationRule | None = DENSIFICATION_RULES["adc"],
    effects: Effects = NO_EFFECTS,
) -> TrainState:
    """Step 0, with statistics of the rule; None: without any."""
    return TrainState(
        gaussians,
        optimizer.init(gaussians),
        rule.empty_statistics(gaussians.num_gaussians) if rule else (),
        jnp.zeros((), jnp.int32),
        simulation.initial_state(effects),
    )


@partial(jax.jit, static_argnames=("optimizer", "density", "budget", "rule"), donate_argnums=0)
def densify(
    state: TrainState,
    key: Array,
    extent: Array,
    prune_large: Array,
    *,
    optimizer: Optimizer,
    density: Density,
    budget: int,
    rule: DensificationRule,
) -> TrainState:
    """Densify within `budget` Gaussians; moments follow their Gaussian, statistics start anew.

    The state is donated: its arrays are deleted, and only the returned state, of the same shapes, can be used from here
    on. Its statistics are those of the rule. The step is folded into the run's random key. `extent` is that of the
    cameras, scene units; `prune_large`, a `[]` bool, says whether size prunes.
    """
    count = rule.wanted_count(state.gaussians, state.statistics, density, step=state.step, budget=budget)
    gaussians, moved = rule.densify(
        state.gaussians,
        state.statistics,
        jax.random.fold_in(key, state.step),
        density=density,
        extent=extent,
        prune_large=prune_large,
        count=count,
    )
    opt_state = optimizers.rearrange_moments(state.opt_state, optimizer, moved.source, moved.fresh)
    statistics = rule.empty_statistics(gaussians.num_gaussians)
    return replace(state, gaussians=gaussians, opt_state=opt_state, statistics=statistics)


@partial(jax.jit, static_argnames="limit", donate_argnums=0)
def reset_opacities(state: TrainState, *, limit: float) -> TrainState:
    """Cap the opacities at `limit` and zero their moments. The state is donated, see `densify`."""
    logit = jnp.log(jnp.float32(limit / (1 - limit)))  # Dead rows are below it, and stay dead.
    gaussians = replace(state.gaussians, logit_opacities=jnp.minimum(state.gaussians.logit_opacities, logit))
    opt_state = optimizers.zero_moments(state.opt_state, "logit_opacities")
    return replace(state, gaussians=gaussians, opt_state=opt_state)


@partial(jax.jit, static_argnames=("optimizer", "min_opacity"), donate_argnums=0)
def cull(state: TrainState, *, optimizer: Optimizer, min_opacity: float) -> TrainState:
    """Free the rows of an opacity under `min_opacity`; other moments stay. The state is donated, see `densify`."""
    return remove(state, opacities(state.gaussians) < min_opacity, optimizer=optimizer)


@partial(jax.jit, static_argnames="optimizer", donate_argnums=0)
def remove(state: TrainState, mask: Array, *, optimizer: Optimizer) -> TrainState:
    """Free the rows of `mask`, `[N]` bool; other moments stay. The state is donated, see `densify`."""
    gaussians = gradient_driven.kill(state.gaussians, mask)
    rows = jnp.arange(gaussians.num_gaussians, dtype=jnp.int32)
    opt_state = optimizers.rearrange_moments(state.opt_state, optimizer, rows, ~is_alive(gaussians))
    return replace(state, gaussians=gaussians, opt_state=opt_state)


@jax.jit
def count_alive(gaussians: Gaussians) -> Array:
    """`[]` int32 Gaussians in the buffer."""
    return jnp.sum(is_alive(gaussians), dtype=jnp.int32)
