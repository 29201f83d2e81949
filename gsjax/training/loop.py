"""The host loop over the phases: which view, when to densify, when a buffer must grow."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from gsjax import targets
from gsjax.effects.model import NO_EFFECTS, Effects
from gsjax.errors import InputError
from gsjax.scene import Frame
from gsjax.settings import Phase, Settings, Weights
from gsjax.targets import Target, Views
from gsjax.training import rows, surroundings
from gsjax.training.capacity import chosen_capacity, rounded_capacity
from gsjax.training.growth import adaptive as density_control
from gsjax.training.growth.rules import RULES
from gsjax.training.state import TrainState, cull, densify, reset_opacities
from gsjax.training.step import BACKGROUNDS, Metrics, TrainStep, active_terms, make_train_step
from gsjax.training.terms.losses import NEEDS_NEIGHBOR, NEEDS_NORMALS, SURFACE_TERMS
from gsjax.training.terms.multi_view import drawn_beside, with_neighbors

S = TypeVar("S")  # A state of training.
NormalsPrior = Callable[[TrainState], Sequence[np.ndarray]]
"""Training so far -> an int8 normal map a frame, see `gsjax.targets.Target`."""

GROWTH = 2.0  # How much longer the pair buffer is than needed while Gaussians multiply,
STILL = 1.25  # and while they do not: a view that needs more costs another compilation.


Feed = Callable[[Views, int, float], Callable[[int], Target]]
"""(photos, seed of their order, share of the device's memory) -> steps done -> what the next step compares with."""


class Placement(NamedTuple):
    """The devices that a run lies on: the functions that know where its Gaussians are. See `one_device`."""

    feed: Feed
    make_step: Callable[..., TrainStep]  # as `make_train_step`
    chosen_capacity: Callable[..., int]
    with_room_to_densify: Callable[..., TrainState]
    densify: Callable[..., TrainState]
    reset_opacities: Callable[..., TrainState]
    cull: Callable[..., TrainState]


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


def one_view(data: Views, seed: int, view_share: float) -> Callable[[int], Target]:
    """A `Feed` of one device: the view of each step in `view_order`, the next one on its way meanwhile.

    Where the views have neighbours, one of them stands beside each.
    """
    fed = targets.feed(data, room=targets.device_room(view_share))

    def of_step(step: int) -> list[int]:
        view = view_order(seed, step, data.num_views)
        return [view] if data.neighbors is None else [view, drawn_beside(data.neighbors[view], seed, step)]

    def target(step: int) -> Target:
        here, *beside = fed(of_step(step), of_step(step + 1))
        return replace(here, beside=beside[0]) if beside else here

    return target


_kept = lru_cache(maxsize=32)(make_train_step)


def kept_step(optimizer: optax.GradientTransformation, weights: Weights, *, effects: Effects, **how: Any) -> TrainStep:
    """`make_train_step`, the same for the same arguments: the next run of these settings finds its programs compiled.

    Effects bring numbers of their run, so that steps with them are made anew.
    """
    return make_train_step(optimizer, weights, effects=effects, **how) if effects else _kept(optimizer, weights, **how)


def one_device() -> Placement:
    """All on one device, a view a step."""
    room = rows.with_room_to_densify
    return Placement(one_view, kept_step, chosen_capacity, room, densify, reset_opacities, cull)


def fit(
    settings: Settings,
    frames: Sequence[Frame],
    extent: float,
    state: TrainState,
    optimizer: optax.GradientTransformation,
    *,
    prior: NormalsPrior,
    observe: Callable[[Progress], None],
    capacity: int | None = None,
    effects: Effects = NO_EFFECTS,
    placement: Placement | None = None,
) -> TrainState:
    """Run all phases from `state.step` on.

    Args:
        settings: The run.
        frames: Training photos, best in memory: every phase reads them.
        extent: Camera extent, scene units.
        state: Where to start; step 0 or a checkpoint. Its buffers are taken.
        optimizer: The transformation that made the state.
        prior: Gives normals to the first phase that needs them.
        observe: Called after every step.
        capacity: Pair buffer to continue with; None counts.
        effects: Those that are simulated; the state must be made for them, their photos be `frames`.
        placement: Where the state lies; None: on one device.

    Returns:
        The final state.

    Raises:
        InputError: The device has no room for so many Gaussians at this size.
    """
    done, start, placement = int(state.step), 0, placement or one_device()
    for phase in planned_phases(settings):
        end = start + phase.steps
        if done < end:
            data = targets.views_of(frames, scale=phase.image_scale)
            if effects:
                data = targets.numbered(data)
            if not NEEDS_NORMALS.isdisjoint(active_terms(phase.weights)):
                data = targets.with_normals(data, prior(state))
            if not NEEDS_NEIGHBOR.isdisjoint(active_terms(phase.weights)):
                data = with_neighbors(data, extent)
            if surroundings.needed(phase) and done == start:
                state = surroundings.refreshed(state)
            beginning = (done, end), data, extent, state, optimizer, observe, capacity, effects, placement
            state = _run_phase(settings, phase, *beginning)
            done, capacity = end, None
        start = end
    return state


def advance(
    compiled: Callable[[int], Callable[[S, Target, Array], tuple[S, Metrics]]],
    after: Callable[[int, S, Metrics, int], S],
    state: S,
    data: Views,
    steps: tuple[int, int],
    *,
    seed: int,
    capacity: int,
    headroom: float = STILL,
    view_share: float = 0.5,
    feed: Feed = one_view,
) -> S:
    """Take the steps of one program, each with its view, and make room where a view needs it.

    Args:
        compiled: Pair capacity -> step. A step that overflows leaves the state as it was, and is repeated.
        after: (steps done, state, metrics, capacity) -> state, after every step.
        state: Where to start.
        data: The views.
        steps: Steps done so far, and at the end.
        seed: Of the order of views, and of the key that every step gets.
        capacity: Pair buffer to start with.
        headroom: How much longer than needed the buffer is made where it was too short.
        view_share: Of the device's memory, for photos; beyond it they are streamed.
        feed: What a step compares with.

    Returns:
        The state after the last step.

    Raises:
        InputError: The device has no room.
    """
    key, target = jax.random.key(seed), feed(data, seed, view_share)
    train_step = compiled(capacity)
    step, end = steps
    while step < end:
        try:
            state, metrics = train_step(state, target(step), key)
            overflowed = bool(metrics.overflowed)
        except jax.errors.JaxRuntimeError as error:
            raise _no_room(error, data, capacity) from error
        if overflowed:
            capacity = rounded_capacity(int(metrics.needed), headroom)
            train_step = compiled(capacity)
            continue
        step += 1
        state = after(step, state, metrics, capacity)
    return state


def _no_room(error: Exception, data: Views, capacity: int) -> Exception:
    """The one line for a device whose memory is full; any other error is a bug and stays what it is."""
    if "RESOURCE_EXHAUSTED" not in str(error):
        return error
    width, height = data.size
    return InputError(
        f"the device has no room for a step at {width}x{height} with {capacity:,} pairs; "
        "make the photos smaller (--downscale) or the Gaussians fewer (--set max_gaussians=N)"
    )


def _run_phase(
    settings: Settings,
    phase: Phase,
    steps: tuple[int, int],
    data: Views,
    extent: float,
    state: TrainState,
    optimizer: optax.GradientTransformation,
    observe: Callable[[Progress], None],
    capacity: int | None,
    effects: Effects,
    placement: Placement,
) -> TrainState:
    key = jax.random.key(settings.seed)
    # Photos without an alpha channel have nothing to compare alphas with.
    weights = phase.weights if data.has_mattes else replace(phase.weights, alpha=0.0)
    headroom = GROWTH if phase.density_control else STILL

    def compiled(capacity: int) -> TrainStep:
        make = partial(
            placement.make_step,
            optimizer,
            capacity=capacity,
            background=BACKGROUNDS[settings.background],
            sh_every=settings.sh_every,
            rule=RULES[settings.density.rule] if phase.density_control else None,
            depth_mode=settings.depth_mode,
            effects=effects,
            extent=extent,
        )
        if phase.surface_every == 1:
            return make(weights)
        image_alone = replace(weights, **dict.fromkeys(SURFACE_TERMS, 0.0))
        return _every(phase.surface_every, make(weights), make(image_alone))

    def after(step: int, state: TrainState, metrics: Metrics, capacity: int) -> TrainState:
        done = step == steps[1]
        if phase.density_control:
            state = _control_density(settings, step, state, optimizer, extent, key, placement)
        if done and phase.cull_below > 0:
            state = placement.cull(state, optimizer=optimizer, min_opacity=phase.cull_below)
        if surroundings.needed(phase) and not done and _moves_neighbors(settings, phase, step):
            state = surroundings.refreshed(state)
        observe(Progress(step, phase, state, metrics, capacity, done))
        return state

    return advance(
        compiled,
        after,
        state,
        data,
        steps,
        seed=settings.seed,
        capacity=capacity or placement.chosen_capacity(state.gaussians, data, headroom=headroom),
        headroom=headroom,
        view_share=settings.view_share,
        feed=placement.feed,
    )


def _every(count: int, due: TrainStep, between: TrainStep) -> TrainStep:
    """The last of every `count` steps is `due`, counted from the run's beginning; the others are `between`."""

    def train_step(state: TrainState, target: Target, key: Array):
        step = due if (int(state.step) + 1) % count == 0 else between
        return step(state, target, key)

    return train_step


def _moves_neighbors(settings: Settings, phase: Phase, step: int) -> bool:
    """Whether the nearest of each Gaussian are to be found again: other Gaussians, or the same for long enough."""
    others = phase.density_control and density_control.densifies(settings.density, step)
    return others or step % surroundings.EVERY == 0


def _control_density(
    settings: Settings,
    step: int,
    state: TrainState,
    optimizer: optax.GradientTransformation,
    extent: float,
    key: Array,
    placement: Placement,
) -> TrainState:
    density = settings.density
    if density_control.densifies(density, step):
        large = jnp.asarray(density_control.prunes_large(density, step))
        state = placement.with_room_to_densify(state, optimizer, density, settings.max_gaussians)
        state = placement.densify(
            state,
            key,
            jnp.float32(extent),
            large,
            optimizer=optimizer,
            density=density,
            budget=settings.max_gaussians,
        )
    if density_control.resets_opacities(density, step, settings.background):
        state = placement.reset_opacities(state, optimizer=optimizer, limit=density.reset_opacity)
    return state
