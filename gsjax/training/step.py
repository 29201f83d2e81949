"""One compiled step per phase: render, lose, update, accumulate."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array

from gsjax import render, views
from gsjax.gaussians import Gaussians
from gsjax.numerics import masked_mean
from gsjax.settings import Density, Weights
from gsjax.training import density_control, optimizers
from gsjax.training.density_control import GrowthStatistics
from gsjax.training.losses import NEEDS_DEPTH, TERMS
from gsjax.views import Views


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TrainState:
    """All that changes while training, and all that a checkpoint holds."""

    gaussians: Gaussians
    opt_state: Any
    statistics: GrowthStatistics
    step: Array  # [] int32 steps done


class Metrics(NamedTuple):
    """What a step reports."""

    loss: Array
    psnr: Array  # of the view that was trained on, before the update
    needed: Array  # pair capacity that the view needed
    overflowed: Array  # the capacity was too short: the state was left as it was
    terms: dict[str, Array]


TrainStep = Callable[[TrainState, Views, Array, Array], tuple[TrainState, Metrics]]
"""(state, views, view index, random key) -> (state, metrics). The state is donated."""

Background = Callable[[Array], Array]
"""key -> `[3]` colour under the images of this step."""

BACKGROUNDS: dict[str, Background] = {
    "white": lambda key: jnp.ones(3, jnp.float32),
    "black": lambda key: jnp.zeros(3, jnp.float32),
    "random": lambda key: jax.random.uniform(key, (3,), jnp.float32),
}


def initial_state(gaussians: Gaussians, optimizer: optax.GradientTransformation) -> TrainState:
    """Step 0."""
    return TrainState(
        gaussians,
        optimizer.init(gaussians),  # pyright: ignore[reportArgumentType]
        density_control.empty_statistics(gaussians.num_gaussians),
        jnp.zeros((), jnp.int32),
    )


def active_terms(weights: Weights) -> dict[str, float]:
    """The terms of non-zero weight; only these are compiled."""
    return {name: weight for name, weight in weights.__dict__.items() if weight != 0}


def make_train_step(
    optimizer: optax.GradientTransformation,
    weights: Weights,
    *,
    capacity: int,
    background: Background,
    sh_every: int,
    with_statistics: bool,
) -> TrainStep:
    """The compiled step of one phase.

    Args:
        optimizer: Over `Gaussians`.
        weights: Of the loss terms.
        capacity: Of the pair buffer. A view that needs more leaves the state untouched and says so.
        background: Colour under the images.
        sh_every: Steps between the bands of the SH ramp.
        with_statistics: Whether growth statistics are gathered.

    Returns:
        A `TrainStep`.
    """
    terms = active_terms(weights)
    with_depth = not NEEDS_DEPTH.isdisjoint(terms)

    def objective(gaussians: Gaussians, probe: Array | None, batch, color: Array, active_degree: Array):
        view = render.view(
            gaussians,
            batch.camera,
            capacity=capacity,
            background=color,
            active_degree=active_degree,
            with_depth=with_depth,
            means2d_probe=probe,
        )
        losses = {name: TERMS[name](gaussians, view, batch) for name in terms}
        total = sum(weight * losses[name] for name, weight in terms.items())
        mse = masked_mean(jnp.mean(jnp.square(jnp.clip(view.colors, 0, 1) - batch.image), -1), batch.valid)
        return total, (losses, mse, view.splats.projection.visible[0], view.splats.pairs)

    @partial(jax.jit, donate_argnums=0)
    def train_step(state: TrainState, data: Views, index: Array, key: Array):
        color = background(jax.random.fold_in(key, state.step))
        batch = views.batch(data, index, color)
        active_degree = state.step // sh_every
        probe = jnp.zeros((state.gaussians.num_gaussians, 2), jnp.float32) if with_statistics else None
        gradient = jax.value_and_grad(objective, argnums=(0, 1) if with_statistics else (0,), has_aux=True)
        (total, (losses, mse, visible, pairs)), gradients = gradient(
            state.gaussians, probe, batch, color, active_degree
        )
        gaussians, opt_state = optimizers.apply_gradients(optimizer, state.gaussians, state.opt_state, gradients[0])
        statistics = state.statistics
        if with_statistics:
            statistics = density_control.accumulate(statistics, gradients[1], visible, *data.size)
        proposed = TrainState(gaussians, opt_state, statistics, state.step + 1)
        # A full buffer means a wrong image: the state stays, the host makes room and repeats the step.
        state = jax.tree.map(lambda old, new: jnp.where(pairs.overflowed, old, new), state, proposed)
        return state, Metrics(total, -10 * jnp.log10(jnp.maximum(mse, 1e-10)), pairs.needed, pairs.overflowed, losses)

    return train_step


@partial(jax.jit, static_argnames=("optimizer", "density"), donate_argnums=0)
def densify(
    state: TrainState,
    key: Array,
    extent: Array,
    prune_large: Array,
    *,
    optimizer: optax.GradientTransformation,
    density: Density,
) -> TrainState:
    """Clone, split and prune; moments follow their Gaussian, statistics start anew."""
    gaussians, moved = density_control.densify(
        state.gaussians,
        state.statistics,
        jax.random.fold_in(key, state.step),
        density=density,
        extent=extent,
        prune_large=prune_large,
    )
    opt_state = optimizers.rearrange_moments(optimizer, state.opt_state, moved.source, moved.fresh)
    return TrainState(gaussians, opt_state, density_control.empty_statistics(gaussians.num_gaussians), state.step)


@partial(jax.jit, static_argnames=("optimizer", "limit"), donate_argnums=0)
def reset_opacities(state: TrainState, *, optimizer: optax.GradientTransformation, limit: float) -> TrainState:
    """Cap the opacities and forget their moments."""
    capacity = state.gaussians.num_gaussians
    # The opacities' moments are the only per-Gaussian arrays of rank 1.
    opt_state = optimizers.map_moments(
        optimizer, lambda m: jnp.zeros_like(m) if m.shape == (capacity,) else m, state.opt_state
    )
    gaussians = density_control.reset_opacities(state.gaussians, limit)
    return TrainState(gaussians, opt_state, state.statistics, state.step)


@partial(jax.jit, static_argnames=("optimizer", "min_opacity"), donate_argnums=0)
def cull(state: TrainState, *, optimizer: optax.GradientTransformation, min_opacity: float) -> TrainState:
    """Remove faint Gaussians; the moments of the others stay."""
    gaussians = density_control.cull(state.gaussians, min_opacity)
    rows = jnp.arange(gaussians.num_gaussians, dtype=jnp.int32)
    opt_state = optimizers.rearrange_moments(optimizer, state.opt_state, rows, ~density_control.is_alive(gaussians))
    return TrainState(gaussians, opt_state, state.statistics, state.step)


@jax.jit
def count_alive(gaussians: Gaussians) -> Array:
    """`[]` int32 Gaussians in the buffer."""
    return jnp.sum(density_control.is_alive(gaussians), dtype=jnp.int32)


@jax.jit
def largest_need(gaussians: Gaussians, data: Views) -> Array:
    """`[]` int32 pair capacity that serves every one of the views."""
    return jax.lax.map(
        lambda index: render.needed_capacity(gaussians, views.camera(data, index)),
        jnp.arange(data.num_views, dtype=jnp.int32),
    ).max()


def chosen_capacity(gaussians: Gaussians, data: Views, *, headroom: float = 1.25) -> int:
    """Pair capacity that holds every view with room to grow.

    Every slot is sorted in every step, used or not, so this is tighter than the buckets of the front door.
    """
    return rounded_capacity(int(largest_need(gaussians, data)), headroom)


def rounded_capacity(needed: int, headroom: float) -> int:
    """`needed` times `headroom`, up to the next multiple of 4096."""
    return -(-int(needed * headroom + 1) // 4096) * 4096
