"""The host loop over the phases: what each compares with and learns from, and when Gaussians multiply."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jax import Array
from jax.sharding import Mesh

from gsjax.effects import sky
from gsjax.effects.simulation import Effects
from gsjax.scene import Frame, Keep, batches, in_memory
from gsjax.scene.batches import Batch, Batches
from gsjax.training import buffers, data_parallel
from gsjax.training.capacity import chosen_capacity, headroom, kept_or
from gsjax.training.densification import gradient_driven
from gsjax.training.densification.rules import DensificationRule
from gsjax.training.optimizers import Optimizer
from gsjax.training.plan import Plan, PlannedPhase
from gsjax.training.state import TrainState, cull, remove, reset_opacities
from gsjax.training.step import BACKGROUNDS, Metrics, TrainStep, kept_step
from gsjax.training.stepping import Feed, advance, describe_fault, one_view, several_views
from gsjax.training.terms import LossTerm, comparable_terms
from gsjax.training.terms.multi_view import with_neighbors
from gsjax.training.trainer import Densification, densify_within

ReadNormals = Callable[[TrainState], Sequence[np.ndarray]]
"""Training so far -> an int8 normal map a frame, see `gsjax.scene.batches.Batch`."""

Depths = Callable[[int], Iterable[tuple[np.ndarray, np.ndarray]]]
"""How many times smaller photos are -> measured depth and its confidence of each frame, see `Batch`."""


class Progress(NamedTuple):
    """What the loop reports after every step."""

    step: int  # steps done, all phases together
    phase: PlannedPhase
    state: TrainState  # valid until the next step, which takes its buffers; a later one where nobody looks
    metrics: Metrics
    capacity: int  # of the pair buffer
    phase_done: bool  # this was the last step of its phase


@dataclass(frozen=True)
class Work:
    """What all phases of a run share."""

    plan: Plan
    frames: Sequence[Frame]  # training photos, best in memory: every phase reads them
    extent: float  # of the cameras, scene units
    optimizer: Optimizer  # the transformation that made the state
    _: KW_ONLY
    normal_source: ReadNormals | None = None  # gives normals to the first phase that needs them
    observe: Callable[[Progress], None] = lambda progress: None  # called after every step
    effects: Effects = field(default_factory=dict)  # the state must be made for them, their photos be `frames`
    mesh: Mesh | None = None  # devices that share the views of a step; None: one device with one view a step
    depths: Depths | None = None  # where a term needs measured depth
    skies: sky.Masks = field(default_factory=dict)  # where photos show sky, if the plan knows of one
    keep: Keep = in_memory  # where the smaller photos and the maps of a phase are
    looks: Callable[[int], bool] | None = None  # at whose state `observe` looks, see `advance`; None with a mesh
    shares: Callable[[], np.ndarray | float] = lambda: 1.0  # of `with_neighbors`; called after `normal_source`
    make_step: Callable[..., TrainStep] = field(default_factory=lambda: kept_step)  # as `make_train_step`


def follow(work: Work, state: TrainState, capacity: int | None = None) -> TrainState:
    """The final state after all phases of a plan from `state.step` on, of step 0 or a checkpoint.

    The state's buffers are taken. `capacity` is the pair buffer to continue with; None counts.

    Raises:
        InputError: A loss or a gradient is not finite, or the device has no room for so many Gaussians at this size.
    """
    done, before = int(state.step), None
    for index, phase in enumerate(work.plan.phases):
        if done >= phase.end:
            continue
        if phase.rule:
            earlier = [each.rule for each in work.plan.phases[:index] if each.rule]
            is_new = done == phase.begin and earlier[-1:] not in ([], [phase.rule])
            state = _with_statistics(state, phase.rule, is_new)
        views = _views(work, phase, state)
        capacity = capacity or _room_for(work, phase, views.image, state, before)
        state, before = PhaseRun(work, phase, views).run(state, done, capacity)
        done, capacity = phase.end, None
    return state


def _with_statistics(state: TrainState, rule: DensificationRule, is_new: bool) -> TrainState:
    """The state with statistics of the rule: sums of another one, which a new rule finds, mean nothing to it."""
    empty = rule.empty_statistics(state.gaussians.num_gaussians)
    fits = jax.tree.structure(empty) == jax.tree.structure(state.statistics)
    return state if fits and not is_new else replace(state, statistics=empty)


class Views(NamedTuple):
    """What the steps of a phase compare with."""

    image: Batches  # those without surface terms
    surface: Batches  # those with them


def _views(work: Work, phase: PlannedPhase, state: TrainState) -> Views:
    """What the phase compares with; the same for all steps where those with surface terms see no smaller photos."""
    scale = phase.scale * phase.surface_scale
    surface = _photos(work, phase, scale)
    if "normals" in phase.needs:
        assert work.normal_source is not None, "the plan has such a term only where there are normals"
        surface = batches.with_normals(surface, work.normal_source(state), scale, work.keep)
    if "measured" in phase.needs:
        assert work.depths is not None, "the plan has such a term only where there is measured depth"
        surface = batches.with_depths(surface, work.depths(scale), work.keep)
    if "neighbor" in phase.needs:
        surface = with_neighbors(surface, work.extent, work.shares() if "normals" in phase.needs else 1.0)
    is_one = phase.surface_scale == 1 or phase.surface_every == 1
    return Views(surface if is_one else _photos(work, phase, phase.scale), surface)


def _photos(work: Work, phase: PlannedPhase, scale: int) -> Batches:
    """The photos so many times smaller, with what steps without surface terms need with them."""
    data = batches.read_batches(work.frames, scale=scale, keep=work.keep)
    if work.effects:
        data = batches.with_photo_numbers(data)
    if "sky" in phase.needs:
        skies = [work.skies.get(frame.name) for frame in work.frames]
        data = batches.with_skies(data, skies, scale, work.keep)
    return data


def _room_for(work: Work, phase: PlannedPhase, data: Batches, state: TrainState, before: int | None) -> int:
    """The pair buffer to begin a phase with: that of the phase before, where it serves."""
    room = headroom(grows=phase.rule is not None)
    gaussians = jax.device_get(state.gaussians) if work.mesh else state.gaussians
    return kept_or(data_parallel.of_first_process(chosen_capacity(gaussians, data, headroom=room)), room, before)


@dataclass(frozen=True)
class PhaseRun:
    """One phase of a run: its compiled step, and what the loop does around every step."""

    work: Work
    phase: PlannedPhase
    views: Views

    def run(self, state: TrainState, done: int, capacity: int) -> tuple[TrainState, int]:
        """The state after all steps of the phase, and the pair buffer that they needed; `done` steps are behind it."""
        work, phase, feed = self.work, self.phase, one_view
        if work.mesh is not None:
            feed = partial(several_views, mesh=work.mesh, views_per_step=work.plan.views_per_step)
        return advance(
            self._compiled,
            self._after,
            state,
            self.views.image,
            (done, phase.end),
            seed=work.plan.seed,
            capacity=capacity,
            room=headroom(grows=phase.rule is not None),
            feed=_feed_of(self.views, feed, phase.surface_every),
            looks=self._looks if work.looks else None,
            explain=self._explain,
        )

    def _step_of(self, terms: tuple[LossTerm, ...], capacity: int) -> TrainStep:
        work, phase, plan = self.work, self.phase, self.work.plan
        return work.make_step(
            work.optimizer,
            comparable_terms(terms, self.views.image),
            capacity=capacity,
            background=BACKGROUNDS[plan.background],
            sh_every=plan.sh_every,
            rule=phase.rule,
            depth_mode=plan.depth_mode,
            effects=work.effects,
            extent=work.extent,
            dropout=phase.dropout,
            mesh=work.mesh,
        )

    def _compiled(self, capacity: int) -> TrainStep:
        every = self._step_of(self.phase.terms, capacity)
        if self.phase.surface_every == 1:
            return every
        return _every(self.phase.surface_every, every, self._step_of(self.phase.image_terms, capacity))

    def _explain(self, step: int, state: TrainState, target: Batch, capacity: int) -> str:
        """Which photos and terms were not finite."""
        phase, plan, data = self.phase, self.work.plan, self.views.image
        terms = phase.terms if _is_due(step, phase.surface_every) else phase.image_terms
        places = range(step * plan.views_per_step, (step + 1) * plan.views_per_step)
        alone = partial(self._step_of, capacity=capacity)
        return describe_fault(comparable_terms(terms, data), alone, state, target, data, seed=plan.seed, places=places)

    def _after(self, step: int, state: TrainState, metrics: Metrics, capacity: int) -> TrainState:
        """Densify, cull and shorten when it is time, then report."""
        work, phase, plan = self.work, self.phase, self.work.plan
        is_last = step == phase.end
        if phase.rule:
            state = _densify_when_due(work, phase.rule, step, state)
        if is_last and phase.cull_below > 0:
            state = cull(state, optimizer=work.optimizer, min_opacity=phase.cull_below)
        if _ends_densification(plan, phase, step) or (is_last and phase.cull_below > 0):
            state = buffers.shorten(state, work.optimizer, plan.max_gaussians)
        if is_last and "sky" in phase.needs:
            in_sky = sky.lies_in(np.asarray(state.gaussians.means), work.frames, work.skies)
            state = remove(state, in_sky, optimizer=work.optimizer)
        work.observe(Progress(step, phase, state, metrics, capacity, is_last))
        return state

    def _looks(self, step: int) -> bool:
        plan, phase = self.work.plan, self.phase
        grows = phase.rule is not None and (
            gradient_driven.densifies(plan.density, step)
            or gradient_driven.resets_opacities(plan.density, step, plan.background)
            or _ends_densification(plan, phase, step)
        )
        return grows or (self.work.looks is not None and self.work.looks(step))


def _feed_of(views: Views, feed: Feed, count: int) -> Feed:
    """The feed by which the last of every `count` steps, as `_every` counts them, sees the photos of the surface."""
    if views.image is views.surface:
        return feed
    both_bytes = views.image.num_bytes + views.surface.num_bytes

    def both(image: Batches, seed: int, view_share: float) -> Callable[[int], Batch]:
        def fed(data: Batches) -> Callable[[int], Batch]:
            return feed(data, seed, view_share * data.num_bytes / both_bytes)  # so that both fit, or neither

        between, due = fed(image), fed(views.surface)
        return lambda step: (due if _is_due(step, count) else between)(step)

    return both


def _is_due(done: int, count: int) -> bool:
    """Whether the step after so many is the last of `count`, counted from the run's beginning."""
    return (done + 1) % count == 0


def _every(count: int, due: TrainStep, between: TrainStep) -> TrainStep:
    """The last of every `count` steps is `due`, counted from the run's beginning; the others are `between`."""

    def train_step(state: TrainState, target: Batch, key: Array):
        done = int(state.step if target.turn is None else target.turn)
        return (due if _is_due(done, count) else between)(state, target, key)

    return train_step


def _ends_densification(plan: Plan, phase: PlannedPhase, step: int) -> bool:
    """Whether Gaussians multiplied up to this step and never will again, with steps to come."""
    ends = [plan.density.stop, *(each.end for each in plan.phases[: plan.grown or 0][-1:])]
    return phase.rule is not None and step in ends and step < plan.steps


def _densify_when_due(work: Work, rule: DensificationRule, step: int, state: TrainState) -> TrainState:
    plan, density = work.plan, work.plan.density
    if gradient_driven.densifies(density, step):
        how, key = Densification(rule, density, work.extent), jax.random.key(plan.seed)
        state = densify_within(state, work.optimizer, how, key, step=step, budget=plan.max_gaussians)
    if gradient_driven.resets_opacities(density, step, plan.background):
        state = reset_opacities(state, limit=gradient_driven.RESET_OPACITY)
    return state
