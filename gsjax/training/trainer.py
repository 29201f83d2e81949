"""A training loop of your own (`docs/own_loop.md`), of the same steps and densifications as a run's loop."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jax import Array

from gsjax import rendering
from gsjax.gaussians import Gaussians
from gsjax.scene.batches import Batch
from gsjax.settings import Density, Rates
from gsjax.training import buffers, optimizers
from gsjax.training import state as states
from gsjax.training.capacity import headroom, rounded_capacity
from gsjax.training.densification import gradient_driven
from gsjax.training.densification.rules import DENSIFICATION_RULES, DensificationRule
from gsjax.training.optimizers import Optimizer
from gsjax.training.state import TrainState
from gsjax.training.step import BACKGROUNDS, Metrics, kept_step
from gsjax.training.stepping import Program
from gsjax.training.terms import TERMS, LossTerm, Term, needs, weigh_terms

Losses = Mapping[str, "float | tuple[float, Term | Callable[..., Array]]"]
"""Name -> weight of a term of the library, or (weight, term of one's own)."""

DENSIFY_UNTIL, FULL_BY = 0.5, 0.6  # shares: of the steps; of those, where the budget is full (preset `fast`)
SH_BANDS = 7  # A band of harmonics opens after each such part of the steps (preset `fast`).


@dataclass(frozen=True)
class SceneAdam(optimizers.Adam):
    """Adam over `Gaussians` that knows its scene and its length: what `adam` returns."""

    extent: float = 1.0  # of the cameras, scene units
    steps: int = 1  # of the training


def adam(extent: float, steps: int, **rates: float) -> SceneAdam:
    """Adam with a learning rate per field of `Gaussians`, those of 3DGS.

    Args:
        extent: Of the cameras, scene units: `Scene.extent`.
        steps: Of the training; the rate of the means decays over them.
        rates: Fields of `gsjax.settings.Rates` that differ.

    Raises:
        ValueError: A rate, the extent or the steps are out of range.
    """
    if not 0 < extent < np.inf:
        raise ValueError(f"extent={extent} is not a positive number")
    if steps < 1:
        raise ValueError(f"steps={steps} is below 1")
    fields = vars(optimizers.make_optimizer(Rates(**rates), float(extent), int(steps)))
    return SceneAdam(**fields, extent=float(extent), steps=int(steps))


def init(gaussians: Gaussians, optimizer: Optimizer) -> TrainState:
    """The state before the first step.

    Args:
        gaussians: `from_points` makes some. Their number of rows is the budget of Gaussians.
        optimizer: Over `Gaussians`: `adam`, or any optax transformation.
    """
    return states.initial_state(gaussians, optimizer, rule=None)


@dataclass(frozen=True)
class Densification:
    """How a state densifies: a rule, its thresholds, and the camera extent that it measures distances in."""

    rule: DensificationRule
    density: Density
    extent: float  # scene units


def densification(
    rule: str | DensificationRule,
    optimizer: Any = None,
    *,
    extent: float | None = None,
    steps: int | None = None,
    **thresholds: Any,
) -> Densification:
    """The densification of a training: over half of its steps, the budget full after 0.3 of them.

    Args:
        rule: Name in `gsjax.training.densification.rules.DENSIFICATION_RULES`, or a rule of one's own.
        optimizer: Of `adam`, which knows extent and steps. Any other: give both.
        extent: Of the cameras, scene units: `Scene.extent`.
        steps: Of the training.
        thresholds: Fields of `gsjax.settings.Density` that differ.

    Raises:
        ValueError: The rule, the extent or the steps are unknown.
    """
    if isinstance(optimizer, SceneAdam):
        extent, steps = extent or optimizer.extent, steps or optimizer.steps
    if extent is None or steps is None:
        raise ValueError(
            "the rule needs extent and steps: use gsjax.adam(...), or gsjax.densification(..., extent=, steps=)"
        )
    if isinstance(rule, str) and rule not in DENSIFICATION_RULES:
        raise ValueError(f"densify={rule!r} is none of {', '.join(DENSIFICATION_RULES)}")
    stop = max(1, round(DENSIFY_UNTIL * steps))
    defaults = {"start": 0, "stop": stop, "full_by": FULL_BY, "reset_every": 0}
    return Densification(
        DENSIFICATION_RULES[rule] if isinstance(rule, str) else rule,
        Density(**{**defaults, **thresholds}),
        extent,
    )


def densify(state: TrainState, key: Array) -> TrainState:
    """Clone, split, move and prune by the rule of `train_step(densify=...)`. Past half of the steps nothing changes.

    The buffers of `state` are donated: use the state that is returned.

    Raises:
        ValueError: No step was taken, or the step has no rule.
    """
    how = state.densification
    if how is None:
        raise ValueError("this state has no densification rule: take a step of train_step(..., densify='error') first")
    step = int(state.step)
    if step >= how.density.stop:
        return state
    return densify_within(state, state.optimizer, how, key, step=step, budget=state.gaussians.num_gaussians)


def densify_within(
    state: TrainState, optimizer: Optimizer, how: Densification, key: Array, *, step: int, budget: int
) -> TrainState:
    """The state after `step` steps, densified, in buffers that hold as many Gaussians as that makes within a budget."""
    return states.densify(
        buffers.with_room_to_densify(state, optimizer, how.density, budget, rule=how.rule),
        key,
        np.float32(how.extent),
        np.bool_(gradient_driven.prunes_large(how.density, step)),
        optimizer=optimizer,
        density=how.density,
        rule=how.rule,
        budget=budget,
    )


def _resolve_losses(losses: Losses) -> tuple[LossTerm, ...]:
    own = {name: loss[1] for name, loss in losses.items() if isinstance(loss, tuple)}
    terms = {name: each if isinstance(each, Term) else Term(each) for name, each in own.items()}
    weights = {name: loss[0] if isinstance(loss, tuple) else loss for name, loss in losses.items()}
    return weigh_terms(weights, {**TERMS, **terms})


class Step:
    """A compiled step that counts its pairs before the first view, and repeats itself where a view has more."""

    def __init__(self, optimizer: Any, terms: tuple[LossTerm, ...], densification: Densification | None, **how: Any):
        """As `train_step` hands them over; `how` goes to `make_train_step`."""
        self.optimizer, self.terms, self.densification = optimizer, terms, densification
        self._compiled = lambda capacity: kept_step(optimizer, terms, capacity=capacity, **how)
        self._program: Program[TrainState] | None = None

    def __call__(self, state: TrainState, view: Batch, key: Array) -> tuple[TrainState, Metrics]:
        """Descend the loss of one view. The buffers of `state` are donated: use the state that is returned."""
        state = self._prepared(state)
        self._check(view)
        if self._program is None:
            room = headroom(grows=self.densification is not None)
            needed = rendering.largest_need(state.gaussians, [view.camera])
            self._program = Program(self._compiled, rounded_capacity(needed, room), room)
        return self._program.whole_step(state, view, key)

    def _prepared(self, state: TrainState) -> TrainState:
        if state.densification == self.densification and state.optimizer == self.optimizer:
            return state
        rows = state.gaussians.num_gaussians
        statistics = self.densification.rule.empty_statistics(rows) if self.densification else ()
        return replace(state, statistics=statistics, densification=self.densification, optimizer=self.optimizer)

    def _check(self, view: Batch) -> None:
        fields = {"normals": view.normals, "measured": view.depth, "sky": view.sky, "neighbor": view.neighbor}
        fields["mesh"] = None  # Only a refinement has one.
        for name in sorted(needs(self.terms) & fields.keys()):
            if fields[name] is None:
                terms = ", ".join(each.name for each in self.terms if name in each.term.needs)
                raise ValueError(f"{terms}: needs {name}, which this view does not have")


def train_step(
    optimizer: Any,
    losses: Losses,
    *,
    densify: str | DensificationRule | Densification | None = None,
    background: str = "black",
    depth_mode: rendering.DepthReading = "front",
    sh_every: int | None = None,
) -> Step:
    """A step of training: `step(state, view, key) -> (state, metrics)`.

    Args:
        optimizer: That made the state.
        losses: The weighted sum that is descended. Only terms of non-zero weight are compiled.
        densify: Rule whose statistics the step gathers for `densify(state, key)`; None: none.
        background: Under the images: "white", "black" or "random".
        depth_mode: What depth is, see `gsjax.render`.
        sh_every: Steps between bands of harmonics. None: a seventh of the optimizer's steps, 1,000 without any.

    Returns:
        The step. `metrics` has loss, PSNR of the view before the update, and the value of every term.

    Raises:
        InputError: A loss has no term.
        ValueError: The background or the rule is unknown.
    """
    if background not in BACKGROUNDS:
        raise ValueError(f"background={background!r} is none of {', '.join(BACKGROUNDS)}")
    how = densify if isinstance(densify, Densification) or densify is None else densification(densify, optimizer)
    every = max(1, optimizer.steps // SH_BANDS) if isinstance(optimizer, SceneAdam) else 1000
    return Step(
        optimizer,
        _resolve_losses(losses),
        how,
        background=BACKGROUNDS[background],
        sh_every=sh_every or every,
        rule=None if how is None else how.rule,
        depth_mode=depth_mode,
        extent=1.0 if how is None else how.extent,
    )
