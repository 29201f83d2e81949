"""A run for a given time: which preset, and how many of its steps this machine does in it.

The first steps of every phase are tried on a few of the photos, with as many Gaussians as the run is to have, and
forgotten.
"""

import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.pipeline.diagnose import diagnosed
from gsjax.pipeline.pace import FIXED_COST, relative_cost
from gsjax.pipeline.sizes import at_size, training_extent
from gsjax.pipeline.trials import SCORED, STEPS, is_near, is_worthwhile
from gsjax.scene import Frame, Scene, in_memory
from gsjax.settings import AUTO, LENGTHS, NONE, SIMULATED, Phase, Settings, total_steps
from gsjax.training import initialize, loop, optimizers, surroundings
from gsjax.training.loop import Progress, planned_phases
from gsjax.training.losses import NEEDS_NORMALS
from gsjax.training.rules import RULES
from gsjax.training.state import initial_state
from gsjax.training.step import active_terms
from gsjax.views import NORMAL_UNIT

RESERVED = 0.1  # of a budget, for photos, scores and what else no step does
SCORING = 8.0  # seconds besides, for programs that score
TRIED_SHARE = 0.1  # of a budget, for the steps that are tried of each phase
WARM, TIMED = 2, 8  # steps of a phase: the first ones compile, the next ones are timed
PHOTOS = 8  # tried on
GROWN = 10  # times the point cloud: Gaussians at the end where the rule of growth names no number
HALF_GROWN = 0.5  # of these, over a phase in which they multiply
WIDENED = 1.4  # by training: pairs of four runs on real photos end at 0.7 to 1.0 of what a trial then has
PER_GAUSSIAN = 0.7  # of a step's time, what grows with the number of Gaussians (docs/accuracy_vs_time.md, every knob)
FEWEST_STEPS = 50  # of a run
SHORTENED = 0.4  # of its steps' time, with which a preset is no better than a shorter one (docs/accuracy_vs_time.md)
# At first Gaussians are wider than a trial's: time for so many plain steps more, at most for half of a run's own.
WIDER_STEPS, WIDER_SHARE = 150, 0.5
OWN_PROGRAMS, OWN_MAP = 2.0, 1.4  # times a plain step's: compiling what makes maps of own depth, and making one

Clock = Callable[[], float]


class Trial(NamedTuple):
    """What the phases of a run take on this machine."""

    seconds_per_step: tuple[float, ...]  # on average, while Gaussians multiply
    overhead: float  # seconds, of compiling all of them; one that multiplies again, for a longer list of pairs
    plain_step: float  # seconds, of the image alone at full size, when all Gaussians are there
    plain_program: float  # seconds that compiling one takes


class Choice(NamedTuple):
    """A run that fits a budget."""

    settings: Settings
    line: str  # says what was chosen


def budgeted(
    scene: str | Path,
    candidates: Mapping[str, Settings],
    seconds: float,
    *,
    clock: Clock = time.perf_counter,
) -> Choice:
    """The settings of a run that takes `seconds`, trying included.

    Of several candidates the longest is taken of which a good part (`SHORTENED`) would fit, else the shortest.

    Args:
        scene: Folder of the data set.
        candidates: Runs to choose from by their names, the shortest first.
        seconds: The budget.
        clock: Tells seconds.

    Raises:
        InputError: The data set cannot be used, a candidate has no steps, or the budget is too short for any.
    """
    for name, settings in candidates.items():
        if not total_steps(settings):
            raise InputError(f"--budget: the phases of {name} have no steps to scale")
    started = clock()
    scenes = {name: at_size(scene, settings)[:2] for name, settings in candidates.items()}
    first = next(iter(scenes))
    trial = tried(*scenes[first], most=TRIED_SHARE * seconds, clock=clock)
    lengths = {other: _predicted(trial, scenes[first][1], settings) for other, (_, settings) in scenes.items()}
    fitting = (other for other in scenes if SHORTENED * lengths[other] <= seconds)
    name = max(fitting, key=lengths.__getitem__, default=first)
    loaded, sized = scenes[name]
    if name != first:
        trial = tried(loaded, sized, most=TRIED_SHARE * seconds, clock=clock)
    looking, near = _looked(loaded, sized, clock)
    left = (1 - RESERVED) * seconds - SCORING - (clock() - started) - trial.overhead - looking
    left -= _mapping(loaded, sized, trial)
    factor = _factor(trial, sized, left)
    if near and is_worthwhile(scaled(sized, factor)):
        left -= _trying(near, trial)
        factor = _factor(trial, sized, left)
    if name == LENGTHS[-1]:
        factor = min(factor, 1.0)
    if factor * total_steps(sized) < FEWEST_STEPS:
        before = (1 - RESERVED) * seconds - left
        a_step = _length(trial, sized) / total_steps(sized) + WIDER_SHARE * _first_step(trial, sized)
        least = (before + FEWEST_STEPS * a_step) / (1 - RESERVED)
        is_plain = planned_phases(sized) == planned_phases(replace(sized, vanilla=True))
        plainer = "" if is_plain else "; --vanilla has no surface phase to compile and needs less"
        raise InputError(
            f"--budget of {seconds:g} s: too short for this data set here, where even {FEWEST_STEPS} steps"
            f" take {least:.0f} s with all that goes before{plainer}"
        )
    chosen = scaled(sized, factor)
    paces = " + ".join(f"{phase.steps:,} at {1e3 * pace:.0f} ms" for phase, pace in zip(
        planned_phases(chosen), trial.seconds_per_step, strict=True))  # fmt: skip
    return Choice(chosen, f"{name}, {factor:.2g} times its steps: {paces}")


def scaled(settings: Settings, factor: float) -> Settings:
    """The same run in `factor` times as many steps: phases, and all that is due at a step, in proportion.

    Gaussians multiply after as many steps as before in a longer run, and after fewer in a shorter one, but 20 at least.
    """

    def times(steps: int, least: int = 1) -> int:
        return max(least, round(factor * steps)) if steps else 0

    density, rates = settings.density, settings.rates
    every = density.every if factor >= 1 else times(density.every, min(density.every, 20))
    large = density.prune_large_after
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
            prune_large_after=None if large is None else times(large),
            reset_every=times(density.reset_every),
        ),
    )


def tried(scene: Scene, settings: Settings, *, most: float, clock: Clock = time.perf_counter) -> Trial:
    """Times the first steps of every kind of phase, each for `most` seconds at the longest.

    All at the largest size that the run's phases have.

    Args:
        scene: The data set, of the size that the run looks at.
        settings: The run.
        most: Seconds; two steps are timed in any case.
        clock: Tells seconds.
    """
    size = training_extent(scene)
    spread = np.linspace(0, len(scene.train_frames) - 1, PHOTOS).astype(int)
    frames = tuple(in_memory(scene.train_frames[index]) for index in dict.fromkeys(spread.tolist()))
    compiling, known, at_largest = {}, {}, {}
    phases = [replace(phase, name="", steps=WARM + TIMED, cull_below=0.0) for phase in planned_phases(settings)]
    largest = _largest(settings)
    for phase in phases:
        # What smaller photos save is known well enough to spare their program.
        large = replace(phase, image_scale=largest.image_scale)
        if large not in at_largest:
            moments = _moments(scene, frames, size, replace(settings, phases=(large,), vanilla=False), most, clock)
            pace = float(np.median(np.diff(moments[WARM:])))
            at_largest[large] = pace, max(moments[WARM] - moments[0] - WARM * pace, 0.0)
        pace, compiling[phase] = at_largest[large]
        known[phase] = pace * relative_cost(phase) / relative_cost(large)
    shares = shares_alive(settings, len(scene.points))
    paces = [known[p] * (1 - PER_GAUSSIAN * (1 - share)) for p, share in zip(phases, shares, strict=True)]
    again = max((seconds for phase, seconds in compiling.items() if phase.density_control), default=0.0)
    plain_pace, plain_program = min(at_largest.values())
    plain_step = plain_pace / relative_cost(largest)
    return Trial(tuple(paces), sum(compiling.values()) + again, plain_step, plain_program)


def shares_alive(settings: Settings, points: int) -> list[float]:
    """By phase, the mean share of the Gaussians at the end that are alive.

    Args:
        settings: The run.
        points: That it starts from.
    """
    phases, density = planned_phases(settings), settings.density
    if density.rule != "error":
        return [HALF_GROWN if phase.density_control else 1.0 for phase in phases]
    first = min(max(points, 1) / settings.max_gaussians, 1.0)
    growing = max(density.full_by * (density.stop - density.start), 1)
    ends = np.cumsum([phase.steps for phase in phases])
    missing = [
        1 - np.clip((np.arange(end - phase.steps, end) + 1 - density.start) / growing, 0, 1)
        for phase, end in zip(phases, ends, strict=True)
    ]
    return [float(np.mean(first**each)) if len(each) else 1.0 for each in missing]


class _EnoughError(Exception):
    """Steps have been timed for long enough."""


def _moments(
    scene: Scene, frames: Sequence[Frame], size: float, settings: Settings, most: float, clock: Clock
) -> list[float]:
    """When the steps of the only phase ended, and before them when the first one began."""
    (phase,) = settings.phases
    # Nobody multiplies while the steps are timed; the statistics for it are gathered all the same.
    still = replace(settings.density, start=phase.steps + 1, stop=phase.steps + 2, reset_every=0)
    settings = replace(settings, density=still)
    optimizer = optimizers.make_optimizer(settings.rates, size, phase.steps)
    gaussians = _grown(scene, settings)
    nearest = surroundings.found(gaussians) if surroundings.needed(phase) else None
    state = initial_state(gaussians, optimizer, RULES[settings.density.rule], nearest=nearest)
    moments = [clock()]

    def note(progress: Progress) -> None:
        del progress
        moments.append(clock())
        if len(moments) > WARM + 2 and moments[-1] - moments[WARM] > most:
            raise _EnoughError

    def facing(_: object) -> list[np.ndarray]:
        return [np.tile(np.int8([0, 0, -NORMAL_UNIT]), (frame.height, frame.width, 1)) for frame in frames]

    with contextlib.suppress(_EnoughError):
        loop.fit(settings, frames, size, state, optimizer, prior=facing, observe=note)
    return moments


def _grown(scene: Scene, settings: Settings) -> Gaussians:
    """As many Gaussians as the run ends with, about the points of the scene."""
    points, colors = scene.points, scene.point_colors
    most = settings.max_gaussians
    count = most if settings.density.rule == "error" else min(most, GROWN * len(points))
    if count > len(points):
        rng = np.random.default_rng(0)
        more = rng.integers(0, len(points), count - len(points))
        spacing = np.asarray(KDTree(points).query(points, min(4, len(points)))[0]).reshape(len(points), -1)[:, -1]
        moved = points[more] + spacing[more, None] * rng.normal(size=(len(more), 3)) / 2
        points, colors = np.concatenate([points, moved.astype(np.float32)]), np.concatenate([colors, colors[more]])
    chosen = np.linspace(0, len(points) - 1, count).astype(int)
    gaussians = initialize.from_points(
        points[chosen],
        colors[chosen],
        capacity=count,
        sh_degree=settings.sh_degree,
        opacity=0.5,
        pixel_filter=settings.pixel_filter,
    )
    return replace(gaussians, log_scales=gaussians.log_scales + math.log(WIDENED))


def _looked(scene: Scene, settings: Settings, clock: Clock) -> tuple[float, list[str]]:
    """Seconds of looking for effects, and which of them a trial would decide."""
    if settings.effects == NONE:
        return 0.0, []
    began = clock()
    found = diagnosed(scene)
    near = [name for name in SIMULATED if settings.effects == AUTO and is_near(name, found.effects[name])]
    return clock() - began, near


def _trying(near: Sequence[str], trial: Trial) -> float:
    """Seconds of trials of effects, on photos of half the size."""
    steps = (2 + len(near)) * (STEPS + SCORED)
    return (1 + len(near)) * trial.plain_program + steps * trial.plain_step * relative_cost(Phase("", 1, image_scale=2))


def _mapping(scene: Scene, settings: Settings, trial: Trial) -> float:
    """Seconds of making the normal maps of the run's own depth, if a phase asks for them."""
    asked = any(not NEEDS_NORMALS.isdisjoint(active_terms(phase.weights)) for phase in planned_phases(settings))
    if settings.normals is not None or not asked:
        return 0.0
    return OWN_PROGRAMS * trial.plain_program + OWN_MAP * trial.plain_step * len(scene.train_frames)


def _factor(trial: Trial, settings: Settings, left: float) -> float:
    """How many times its steps a run takes in so many seconds."""
    whole, first = _length(trial, settings), _first_step(trial, settings)
    return max(left / (whole + WIDER_SHARE * total_steps(settings) * first), (left - WIDER_STEPS * first) / whole)


def _first_step(trial: Trial, settings: Settings) -> float:
    """Seconds of a step of the image alone on the run's largest photos."""
    return trial.plain_step * relative_cost(_largest(settings))


def _largest(settings: Settings) -> Phase:
    """A phase of the image alone, its photos as large as any that the run looks at."""
    return Phase("", 1, image_scale=min(phase.image_scale for phase in planned_phases(settings)))


def _length(trial: Trial, settings: Settings) -> float:
    """Seconds of all steps."""
    return sum(phase.steps * pace for phase, pace in zip(planned_phases(settings), trial.seconds_per_step, strict=True))


def _predicted(trial: Trial, settings: Settings, other: Settings) -> float:
    """Seconds of all steps of another run on the same photos, from those of one that was tried; both name a size."""
    if other == settings:
        return _length(trial, settings)
    costs = [relative_cost(phase) for phase in planned_phases(settings)]
    unit = float(np.median(np.divide(trial.seconds_per_step, costs)))
    assert settings.downscale and other.downscale
    pixels = (settings.downscale / other.downscale) ** 2
    gaussians = other.max_gaussians / settings.max_gaussians
    unit *= FIXED_COST * gaussians + (1 - FIXED_COST) * pixels
    return unit * sum(phase.steps * relative_cost(phase) for phase in planned_phases(other))
