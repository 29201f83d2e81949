"""Short trials from one state: what another setting would bring, told by what was kept from them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import optax

from gsjax import targets
from gsjax.effects.simulation import Effects
from gsjax.scene import Frame
from gsjax.settings import PLAIN
from gsjax.targets import Target, Targets
from gsjax.training.capacity import chosen_capacity
from gsjax.training.loop import kept_step
from gsjax.training.plan import Plan
from gsjax.training.state import TrainState
from gsjax.training.step import BACKGROUNDS, Metrics, TrainStep
from gsjax.training.stepping import advance
from gsjax.training.terms import weigh_terms

SCALE = 2  # of the photos: trials look at smaller ones
KEPT = 8  # One in so many photos, or blocks of pixels, is kept from a trial,
BLOCKS = 16  # blocks across the longer side of a photo


def run_trial(
    make: Callable[[int], TrainStep],
    state: TrainState,
    shown: Targets,
    kept: Targets,
    steps: int,
    *,
    seed: int,
    observe: Callable[[], object] = lambda: None,
) -> tuple[TrainState, float]:
    """So many steps from a state, and how well they predict what they were not shown.

    Args:
        make: Pair capacity -> the step of the trial, see `step_factory`.
        state: Where to start; it is left as it is.
        shown: What is trained on.
        kept: What is scored, before a step could learn from it. Sizes as in `shown`: one program serves both.
        steps: Their number.
        seed: Of the order of views.
        observe: Told after every step, and after every view that is scored.

    Returns:
        The state after the steps, and the mean PSNR of `kept` with all effects that the steps have, decibels.
    """
    capacity, reported = chosen_capacity(state.gaussians, shown), []

    def go_on(step: int, state: TrainState, metrics: Metrics, capacity: int) -> TrainState:
        observe()
        return state

    end, _ = advance(make, go_on, _copied(state), shown, (0, steps), seed=seed, capacity=capacity)

    def report(step: int, state: TrainState, metrics: Metrics, capacity: int) -> TrainState:
        observe()
        reported.append(float(metrics.psnr))
        return _copied(end)

    advance(make, report, _copied(end), kept, (0, kept.num_views), seed=seed, capacity=capacity)
    return end, float(np.mean(reported))


def step_factory(
    plan: Plan,
    weights: Mapping[str, float],
    optimizer: optax.GradientTransformation,
    data: Targets,
    *,
    effects: Effects,
    sh_every: int,
) -> Callable[[int], TrainStep]:
    """Pair capacity -> a step of the image alone: no term of the surface, no density control. Compiled once for all."""
    image = weigh_terms({name: weights.get(name, 0.0) for name in PLAIN if name != "alpha" or data.has_mattes})
    options = {"background": BACKGROUNDS[plan.background], "sh_every": sh_every, "depth_mode": plan.depth_mode}
    return cache(lambda capacity: kept_step(optimizer, image, capacity=capacity, rule=None, effects=effects, **options))


def small_views(frames: Sequence[Frame]) -> Targets:
    """The photos as trials see them: smaller, where that leaves anything, each told which it is."""
    smallest = min(min(frame.width, frame.height) for frame in frames)
    data = targets.read_targets(frames, scale=SCALE if smallest >= SCALE * BLOCKS else 1)
    return targets.with_photo_numbers(data)


def by_photo(data: Targets) -> tuple[Targets, Targets]:
    """All but every `KEPT`-th photo, and those; of few photos the last alone is kept."""
    kept = [index % KEPT == KEPT // 2 for index in range(data.num_views)]
    kept[-1] |= not any(kept)
    return tuple(
        Targets(tuple(t for t, is_kept in zip(data.targets, kept, strict=True) if is_kept == side))
        for side in (False, True)
    )  # pyright: ignore[reportReturnType]


def by_block(data: Targets) -> tuple[Targets, Targets]:
    """All photos without every `KEPT`-th of their square blocks, and with these alone."""
    return tuple(Targets(tuple(_with_blocks(t, kept=side) for t in data.targets)) for side in (False, True))  # pyright: ignore[reportReturnType]


def _with_blocks(target: Target, *, kept: bool) -> Target:
    height, width = target.image.shape[:2]
    side = max(1, max(height, width) // BLOCKS)
    # Neighbouring rows of blocks are shifted, photos too: every place is kept in one of them.
    row, column = np.arange(height)[:, None] // side, np.arange(width)[None] // side
    is_kept = (column + 3 * row + int(target.photo if target.photo is not None else 0)) % KEPT == 0
    usable = is_kept if kept else ~is_kept
    return replace(target, valid=usable if target.valid is None else usable & target.valid)


def _copied(state: TrainState) -> TrainState:
    """The same state in buffers of its own: a step takes those that it is given."""
    return jax.tree.map(jnp.copy, state)
