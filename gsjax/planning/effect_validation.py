"""Whether the effects that the evidence proposes are simulated: validation runs with and without each, in turn.

Every photo lacks a quarter of its pixels in large blocks. The runs never see them, and predict them from the other
photos and from what the rest of the same photo implies about its camera. Held-out photos of the scene play no part.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from tqdm import tqdm

from gsjax.effects.observations import Observations
from gsjax.planning.effect_runs import EffectRuns, Initial, held_out_blocks, without_blocks
from gsjax.planning.pace import FIXED_COST, relative_cost
from gsjax.planning.validation import ValidationGain, image_scale, short_settings
from gsjax.scene import Frame, preload
from gsjax.settings import Model, Phase, Settings
from gsjax.training.plan import Plan

SHARE = 0.05  # of the run's time that all validation runs take, as far as each has `FEWEST_STEPS`
# After 42 steps the true exposure of *fox* loses 0.3 dB; it gains 0.3 dB after 100, 200, 300 and 800.
MOST_STEPS, FEWEST_STEPS = 300, 100  # of each
SHORTEST = 600  # steps of a run that is validated
SIDE = 96  # pixels of the longest photo, about: the smaller, the sooner a run shows what remains to be explained
PHOTOS, NEIGHBORS = 48, 6  # that validation runs are trained on, in groups of consecutive ones, which overlap
RENDERED = 0.3  # of a step's time, rendering a photo
Validate = Callable[[Observations, Sequence[str]], dict[str, ValidationGain]]
"""(photos, proposed effects) -> the gain of each proposed."""


def steps_of_each(planned: Plan, frames: Sequence[Frame], count: int) -> int | None:
    """Steps of each validation run of so many effects; None: the run is too short to be validated."""
    if planned.photos_seen < SHORTEST or not count:
        return None
    whole = planned.views_per_step * sum(phase.steps * relative_cost(phase) for phase in planned.phases)
    short = short_settings(Settings(model=Model(max_gaussians=planned.max_gaussians)), frames, 0, SIDE)
    gaussians = short.model.max_gaussians / planned.max_gaussians
    step = FIXED_COST * gaussians + (1 - FIXED_COST) / _scale(planned, frames) ** 2
    steps = int(SHARE * whole / (step * (count + 1)) - RENDERED * min(len(frames), PHOTOS))
    return min(max(steps, FEWEST_STEPS), MOST_STEPS)


def _scale(planned: Plan, frames: Sequence[Frame]) -> int:
    """Photos are reduced at least as far as the run's smallest ones."""
    return max(image_scale(frames, SIDE), *(phase.scale for phase in planned.phases))


@dataclass(frozen=True)
class EffectValidation:
    """Validates the effects of a run: a `Validate`."""

    settings: Settings  # the run
    planned: Plan
    frames: Sequence[Frame]  # that are trained on
    extent: float  # camera extent, scene units
    initial: Initial

    def __call__(self, observations: Observations, proposed: Sequence[str]) -> dict[str, ValidationGain]:
        """The gain of each proposed effect, added to those before it that passed.

        Empty where the run is too short.
        """
        steps = steps_of_each(self.planned, self.frames, len(proposed))
        if steps is None:
            return {}
        frames = tuple(map(preload, chosen_photos(self.frames)))
        blocks = [held_out_blocks(frame, index) for index, frame in enumerate(frames)]
        observations = without_blocks(observations, frames, blocks)
        runs = EffectRuns(self._short(steps), self.extent, self.initial, proposed, observations, frames, blocks)
        total, title = (len(proposed) + 1) * steps, f"validating {', '.join(proposed)}"
        with tqdm(total=total, desc=title, unit="step", leave=False) as bar:
            return select(proposed, partial(runs.predict, observe=bar.update), runs.compare)

    def _short(self, steps: int) -> Settings:
        short = short_settings(self.settings, self.frames, 0, SIDE)
        phase = Phase("validation", steps, image_scale=_scale(self.planned, self.frames))
        behind = "black" if short.model.background == "random" else short.model.background
        schedule = {"phases": (phase,), "sh_every": max(steps // 6, 1)}
        return short.replace(schedule=schedule, model={"background": behind})


def select(
    proposed: Sequence[str],
    predict: Callable[[Sequence[str]], list[np.ndarray]],
    compare: Callable[[list[np.ndarray], list[np.ndarray]], ValidationGain],
) -> dict[str, ValidationGain]:
    """Forward selection: every effect is compared with those that passed before it.

    `predict` draws pictures by the effects that are simulated; `compare` is of pictures without an effect and with it.
    """
    passed: tuple[str, ...] = ()
    without, gains = predict(passed), {}
    for name in proposed:
        with_effect = predict((*passed, name))
        gains[name] = compare(without, with_effect)
        if gains[name].passes:
            passed, without = (*passed, name), with_effect
    return gains


def chosen_photos(frames: Sequence[Frame]) -> tuple[Frame, ...]:
    """At most `PHOTOS` of them, in groups of consecutive ones that are spread evenly."""
    if len(frames) <= PHOTOS:
        return tuple(frames)
    starts = np.linspace(0, len(frames) - NEIGHBORS, PHOTOS // NEIGHBORS).astype(int)
    return tuple(frames[index] for index in np.unique(starts[:, None] + np.arange(NEIGHBORS)))
