"""The host loop over the phases: which view, when to densify, when the pair buffer must grow."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from gsjax.gaussians import Gaussians
from gsjax.scene import Frame
from gsjax.settings import Phase, Settings, Weights
from gsjax.training import density_control
from gsjax.training.losses import NEEDS_NORMALS
from gsjax.training.step import (
    BACKGROUNDS,
    Metrics,
    TrainState,
    TrainStep,
    active_terms,
    chosen_capacity,
    cull,
    densify,
    make_train_step,
    reset_opacities,
    rounded_capacity,
)
from gsjax.views import Views, stack_views

S = TypeVar("S")  # A state of training.
NormalsPrior = Callable[[Gaussians, Views], Views]
"""(Gaussians so far, views) -> views with normals."""


class Progress(NamedTuple):
    """What the loop tells after every step."""

    step: int  # steps done, all phases together
    phase: Phase
    state: TrainState  # valid until the next step, which takes its buffers
    metrics: Metrics
    capacity: int  # of the pair buffer
    phase_done: bool  # this was the last step of its phase


def planned_phases(settings: Settings) -> tuple[Phase, ...]:
    """The phases as they run: with `settings.vanilla`, the same steps of the photometric loss alone."""
    if not settings.vanilla:
        return settings.phases
    return tuple(
        Phase(
            p.name,
            p.steps,
            Weights(l1=p.weights.l1, dssim=p.weights.dssim, alpha=p.weights.alpha),
            p.image_scale,
            p.density_control,
        )
        for p in settings.phases
    )


def view_order(seed: int, step: int, num_views: int) -> int:
    """The view of a step: a fresh random permutation every epoch, a function of (seed, step) alone."""
    epoch, position = divmod(step, num_views)
    return int(np.random.default_rng((seed, epoch)).permutation(num_views)[position])


def fit(
    settings: Settings,
    frames: tuple[Frame, ...],
    extent: float,
    state: TrainState,
    optimizer: optax.GradientTransformation,
    *,
    prior: NormalsPrior,
    observe: Callable[[Progress], None],
    capacity: int | None = None,
) -> TrainState:
    """Run all phases from `state.step` on.

    Args:
        settings: The run.
        frames: Training photos.
        extent: Camera extent, scene units.
        state: Where to start; step 0 or a checkpoint. Its buffers are taken.
        optimizer: The transformation that made the state.
        prior: Gives normals to the views of the first phase that needs them.
        observe: Called after every step.
        capacity: Pair buffer to continue with; None counts.

    Returns:
        The final state.
    """
    key = jax.random.key(settings.seed)
    done, start = int(state.step), 0
    for phase in planned_phases(settings):
        end = start + phase.steps
        if done < end:
            data = stack_views(frames, scale=phase.image_scale)
            if not NEEDS_NORMALS.isdisjoint(active_terms(phase.weights)):
                data = prior(state.gaussians, data)
            state, done = _run_phase(
                settings, phase, (done, end), data, extent, state, optimizer, key, observe, capacity
            )
            capacity = None
        start = end
    return state


def advance(
    compiled: Callable[[int], Callable[[S, Views, Array, Array], tuple[S, Metrics]]],
    after: Callable[[int, S, Metrics, int], S],
    state: S,
    data: Views,
    steps: tuple[int, int],
    *,
    seed: int,
    capacity: int,
) -> S:
    """Take the steps of one program, each with a view of `view_order`, and make room where a view needs it.

    Args:
        compiled: Pair capacity -> step. A step that overflows leaves the state as it was, and is repeated.
        after: (steps done, state, metrics, capacity) -> state, after every step.
        state: Where to start.
        data: The views.
        steps: Steps done so far, and at the end.
        seed: Of the order of views, and of the key that every step gets.
        capacity: Pair buffer to start with.

    Returns:
        The state after the last step.
    """
    key = jax.random.key(seed)
    train_step = compiled(capacity)
    step, end = steps
    while step < end:
        index = jnp.int32(view_order(seed, step, data.num_views))
        state, metrics = train_step(state, data, index, key)
        if bool(metrics.overflowed):
            capacity = rounded_capacity(int(metrics.needed), 1.25)
            train_step = compiled(capacity)
            continue
        step += 1
        state = after(step, state, metrics, capacity)
    return state


def _run_phase(
    settings: Settings,
    phase: Phase,
    steps: tuple[int, int],
    data: Views,
    extent: float,
    state: TrainState,
    optimizer: optax.GradientTransformation,
    key: Array,
    observe: Callable[[Progress], None],
    capacity: int | None,
) -> tuple[TrainState, int]:
    # Photos without an alpha channel have nothing to compare alphas with.
    weights = phase.weights if data.mattes is not None else replace(phase.weights, alpha=0.0)

    def compiled(capacity: int) -> TrainStep:
        return make_train_step(
            optimizer,
            weights,
            capacity=capacity,
            background=BACKGROUNDS[settings.background],
            sh_every=settings.sh_every,
            with_statistics=phase.density_control,
        )

    if capacity is None:
        # Splitting raises the number of pairs; too small a guess costs one more compilation.
        headroom = 1.5 if phase.density_control else 1.25
        capacity = chosen_capacity(state.gaussians, data, headroom=headroom)

    def after(step: int, state: TrainState, metrics: Metrics, capacity: int) -> TrainState:
        done = step == steps[1]
        if phase.density_control:
            state = _control_density(settings, step, state, optimizer, extent, key)
        if done and phase.cull_below > 0:
            state = cull(state, optimizer=optimizer, min_opacity=phase.cull_below)
        observe(Progress(step, phase, state, metrics, capacity, done))
        return state

    return advance(compiled, after, state, data, steps, seed=settings.seed, capacity=capacity), steps[1]


def _control_density(
    settings: Settings, step: int, state: TrainState, optimizer: optax.GradientTransformation, extent: float, key: Array
) -> TrainState:
    density = settings.density
    if density_control.densifies(density, step):
        large = jnp.asarray(density_control.prunes_large(density, step))
        state = densify(state, key, jnp.float32(extent), large, optimizer=optimizer, density=density)
    if density_control.resets_opacities(density, step, settings.background):
        state = reset_opacities(state, optimizer=optimizer, limit=density.reset_opacity)
    return state
