"""A run for a given time: which preset, and how many of its steps and Gaussians this machine bears in it."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import root_scalar

from gsjax.errors import InputError
from gsjax.planning import effect_validation, validation
from gsjax.planning.effects import PROPOSED, diagnose_scene
from gsjax.planning.holding_back import FOLDS
from gsjax.planning.pace import FIXED_COST, image_cost, relative_cost
from gsjax.planning.sizes import at_size
from gsjax.planning.sparse_views import angle_between_photos, is_tried
from gsjax.planning.timed_steps import Clock, StepTimes, largest_scale, step_cost, time_steps
from gsjax.scene import Scene
from gsjax.settings import AUTO, LENGTHS, NONE, Settings, total_steps
from gsjax.training.plan import plan

RESERVED = 0.1  # of a budget, for photos, scores and what else no step does
SCORING = 8.0  # seconds besides, for programs that score
TRIED_SHARE = 0.1  # of a budget, for the steps that are tried of each phase
FEWEST_STEPS = 50  # of a run
FEWEST_ROUNDS, SHORTEST_INTERVAL = 8, 20  # in which Gaussians multiply, and steps between two of them
SHORTENED = 0.4  # of its steps' time, with which a preset is no better than a shorter one (docs/accuracy_vs_time.md)
# At first Gaussians are wider than a trial's: time for so many plain steps more, at most for half of a run's own.
WIDER_STEPS, WIDER_SHARE = 150, 0.5
VALIDATION_PROGRAMS = 2.0  # that validation of effects compiles: a step and a picture
OWN_PROGRAMS, OWN_MAP = 2.0, 1.4  # times a plain step's: compiling what makes maps of own depth, and making one

Lasting = Callable[[Settings, float], Settings]
"""(a run, a number) -> the run that takes so many times its time."""


def scaled(settings: Settings, factor: float) -> Settings:
    """The same run in `factor` times as many steps: phases, and all that is due at a step, in proportion.

    Gaussians multiply after as many steps as before in a longer run. In a shorter one too, by error, as long as they do
    so `FEWEST_ROUNDS` times: who has moved needs steps to settle. By 3DGS's rule the number of Gaussians hangs on how
    often, so they multiply as often as before, but after 20 steps at least.
    """

    def times(steps: int, least: int = 1) -> int:
        return max(least, round(factor * steps)) if steps else 0

    density, rates = settings.density, settings.rates
    wanted = density.every if factor >= 1 else times(density.every)
    if density.rule == "error":
        wanted = max(wanted, (times(density.stop) - times(density.start)) // FEWEST_ROUNDS)
    every = min(density.every, max(SHORTEST_INTERVAL, wanted))
    return replace(
        settings,
        phases=tuple(replace(phase, steps=times(phase.steps)) for phase in settings.phases),
        sh_every=times(settings.sh_every),
        rates=replace(rates, decay_steps=None if rates.decay_steps is None else times(rates.decay_steps)),
        density=replace(
            density,
            start=times(density.start),
            stop=times(density.stop),
            every=every,
            reset_every=times(density.reset_every),
        ),
    )


def resized(settings: Settings, factor: float) -> Settings:
    """A run of `factor` times the time, which more or fewer Gaussians and steps share.

    As many times the Gaussians as its square root: half of a short run's steps cost more than half of its Gaussians,
    and twice a long one's bring less (docs/accuracy_vs_time.md). The steps alone, where Gaussians multiply freely.
    """
    if settings.density.rule != "error":
        return scaled(settings, factor)
    gaussians = math.sqrt(factor)
    most = max(1, round(gaussians * settings.max_gaussians))
    return replace(scaled(settings, factor / step_cost(gaussians)), max_gaussians=most)


class Choice(NamedTuple):
    """A run that fits a budget."""

    settings: Settings
    line: str  # says what was chosen


def budgeted(
    scene: str | Path,
    candidates: Mapping[str, Settings],
    seconds: float,
    lasting: Lasting = resized,
    *,
    clock: Clock = time.perf_counter,
) -> Choice:
    """The settings of a run that takes `seconds`, trying included.

    Of several candidates the longest is taken of which a good part (`SHORTENED`) would fit, else the shortest.

    Args:
        scene: Folder of the data set.
        candidates: Runs to choose from by their names, the shortest first.
        seconds: The budget.
        lasting: How a run becomes shorter or longer: in steps and Gaussians, or by `scaled` in steps alone.
        clock: Tells seconds.

    Raises:
        InputError: The data set cannot be used, a candidate has no steps, or the budget is too short for any.
    """
    for name, settings in candidates.items():
        if not total_steps(settings):
            raise InputError(f"--budget: the phases of {name} have no steps to scale")
    started = clock()
    scenes = {}
    for name, settings in candidates.items():
        loaded, downscale, _ = at_size(scene, settings, total_steps(settings))
        scenes[name] = loaded, replace(settings, downscale=downscale)
    first = next(iter(scenes))
    times = time_steps(*scenes[first], most=TRIED_SHARE * seconds, clock=clock)
    lengths = {other: _predicted(times, scenes[first][1], settings) for other, (_, settings) in scenes.items()}
    fitting = (other for other in scenes if SHORTENED * lengths[other] <= seconds)
    name = max(fitting, key=lengths.__getitem__, default=first)
    loaded, sized = scenes[name]
    if name != first:
        times = time_steps(loaded, sized, most=TRIED_SHARE * seconds, clock=clock)
    looking, proposed = _looked(loaded, sized, clock)
    left = (1 - RESERVED) * seconds - SCORING - (clock() - started) - times.overhead - looking
    left -= _mapping(loaded, sized, times)
    part = _part(times, sized, left)
    if proposed and total_steps(lasting(sized, part)) >= effect_validation.SHORTEST:
        left = (left - VALIDATION_PROGRAMS * times.plain_program) / (1 + effect_validation.SHARE)
        part = _part(times, sized, left)
    if _tries_to_hold_back(loaded, lasting(sized, part)):
        left -= _holding_back(loaded, times)
        part = _part(times, sized, left)
    if name == LENGTHS[-1]:
        part = min(part, 1.0)
    chosen = lasting(sized, part)
    if total_steps(chosen) < FEWEST_STEPS:
        before = (1 - RESERVED) * seconds - left
        least = (before + _least_part(sized, lasting) * _short_length(times, sized)) / (1 - RESERVED)
        is_plain = plan(sized).phases == plan(replace(sized, vanilla=True)).phases
        plainer = "" if is_plain else "; --vanilla has no surface phase to compile and needs less"
        raise InputError(
            f"--budget of {seconds:g} s: too short for this data set here, where even {FEWEST_STEPS} steps"
            f" take {least:.0f} s with all that goes before{plainer}"
        )
    cost = step_cost(chosen.max_gaussians / sized.max_gaussians)
    paces = " + ".join(f"{phase.steps:,} at {1e3 * cost * pace:.0f} ms" for phase, pace in zip(
        chosen.phases, times.seconds_per_step, strict=True))  # fmt: skip
    return Choice(chosen, f"{name}, {part:.2g} times as long: {chosen.max_gaussians:,} Gaussians, steps {paces}")


def _looked(scene: Scene, settings: Settings, clock: Clock) -> tuple[float, list[str]]:
    """Seconds of looking for effects, and which of them the run would validate."""
    if settings.effects == NONE:
        return 0.0, []
    began = clock()
    found = diagnose_scene(scene)
    proposed = [name for name in PROPOSED if settings.effects == AUTO and found.effects[name].on]
    return clock() - began, proposed


def _tries_to_hold_back(scene: Scene, settings: Settings) -> bool:
    """Whether trials decide if training is held back."""
    looks = settings.sparse_views and not settings.vanilla
    return looks and is_tried(len(scene.train_frames), angle_between_photos(scene), total_steps(settings))


def _holding_back(scene: Scene, times: StepTimes) -> float:
    """Seconds of the trials that decide it."""
    steps = 2 * FOLDS * validation.STEPS
    smaller = validation.image_scale(scene.train_frames)
    return 2 * times.plain_program + steps * times.plain_step * image_cost(smaller)


def _mapping(scene: Scene, settings: Settings, times: StepTimes) -> float:
    """Seconds of making the normal maps of the run's own depth, if a phase asks for them."""
    if settings.normals is not None or "normals" not in plan(settings).needs:
        return 0.0
    return OWN_PROGRAMS * times.plain_program + OWN_MAP * times.plain_step * len(scene.train_frames)


def _part(times: StepTimes, settings: Settings, left: float) -> float:
    """How many times its own time so many seconds are to a run; 0 at least."""
    wider = (left - WIDER_STEPS * _first_step(times, settings)) / _length(times, settings)
    return max(left / _short_length(times, settings), wider, 0.0)


def _least_part(settings: Settings, lasting: Lasting) -> float:
    """How many times its own time a run of the fewest steps is."""

    def missing(part: float) -> float:
        return FEWEST_STEPS - 0.5 - total_steps(lasting(settings, part))

    return root_scalar(missing, bracket=(0, FEWEST_STEPS**2), method="bisect").root


def _first_step(times: StepTimes, settings: Settings) -> float:
    """Seconds of a step of the image alone on the run's largest photos."""
    return times.plain_step * image_cost(largest_scale(plan(settings)))


def _length(times: StepTimes, settings: Settings) -> float:
    """Seconds of all steps."""
    return sum(phase.steps * pace for phase, pace in zip(settings.phases, times.seconds_per_step, strict=True))


def _short_length(times: StepTimes, settings: Settings) -> float:
    """Seconds of all steps, were they of a run so short that Gaussians are wide for much of it."""
    return _length(times, settings) + WIDER_SHARE * total_steps(settings) * _first_step(times, settings)


def _predicted(times: StepTimes, settings: Settings, other: Settings) -> float:
    """Seconds of all steps of another run on the same photos, from those of one that was tried; both name a size."""
    if other == settings:
        return _length(times, settings)
    costs = [relative_cost(phase) for phase in plan(settings).phases]
    unit = float(np.median(np.divide(times.seconds_per_step, costs)))
    assert settings.downscale and other.downscale
    pixels = (settings.downscale / other.downscale) ** 2
    gaussians = other.max_gaussians / settings.max_gaussians
    unit *= FIXED_COST * gaussians + (1 - FIXED_COST) * pixels
    return unit * sum(phase.steps * relative_cost(phase) for phase in plan(other).phases)
