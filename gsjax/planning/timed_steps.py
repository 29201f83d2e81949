"""What the steps of a run take on this machine.

The first steps of every phase are tried on a few of the photos, with as many Gaussians as the run is to have, and
forgotten.
"""

import contextlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from gsjax.gaussians import Gaussians
from gsjax.planning.pace import image_cost, relative_cost
from gsjax.planning.sizes import training_extent
from gsjax.planning.sparse_views import for_sparse_views
from gsjax.scene import Frame, Scene, kept
from gsjax.scene.batches import NORMAL_UNIT
from gsjax.settings import Settings
from gsjax.training import initialize, loop, optimizers
from gsjax.training.growth.rules import rule_named
from gsjax.training.loop import Progress
from gsjax.training.plan import Plan, plan
from gsjax.training.state import initial_state

WARM, TIMED = 4, 8  # steps of a phase: the first ones compile (the dear ones of `fast` too), the next are timed
PHOTOS = 8  # tried on
GROWN = 10  # times the point cloud: Gaussians at the end where the rule of growth names no number
HALF_GROWN = 0.5  # of these, over a phase in which they multiply
WIDENED = 1.4  # by training: pairs of four runs on real photos end at 0.7 to 1.0 of what a trial then has
PER_GAUSSIAN = 0.7  # of a step's time, what grows with the number of Gaussians (docs/accuracy_vs_time.md)

Clock = Callable[[], float]


class StepTimes(NamedTuple):
    """What the phases of a run take on this machine."""

    seconds_per_step: tuple[float, ...]  # on average, while Gaussians multiply
    overhead: float  # seconds, of compiling all of them; one that multiplies again, for a longer list of pairs
    plain_step: float  # seconds, of the image alone at full size, when all Gaussians are there
    plain_program: float  # seconds that compiling one takes


def time_steps(scene: Scene, settings: Settings, *, most: float, clock: Clock = time.perf_counter) -> StepTimes:
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
    frames = tuple(kept(scene.train_frames[index]) for index in dict.fromkeys(spread.tolist()))
    compiling, known, at_largest = {}, {}, {}
    planned, _ = for_sparse_views(plan(settings), scene, settings)
    settings = replace(settings, max_gaussians=planned.max_gaussians)
    phases = [replace(phase, name="", begin=0, end=WARM + TIMED, cull_below=0.0) for phase in planned.phases]
    scale = largest_scale(planned)
    for phase in phases:
        # What smaller photos save is known well enough to spare their program.
        large = replace(phase, scale=scale)
        if large not in at_largest:
            moments = _moments(scene, frames, size, settings, replace(planned, phases=(large,)), most, clock)
            pace = float(np.median(np.diff(moments[WARM:])))
            at_largest[large] = pace, max(moments[WARM] - moments[0] - WARM * pace, 0.0)
        pace, compiling[phase] = at_largest[large]
        known[phase] = pace * relative_cost(phase) / relative_cost(large)
    shares = shares_alive(planned, len(scene.points))
    paces = [known[phase] * step_cost(share) for phase, share in zip(phases, shares, strict=True)]
    again = max((seconds for phase, seconds in compiling.items() if phase.rule), default=0.0)
    plain_pace, plain_program = min(at_largest.values())
    plain_step = plain_pace / image_cost(scale)
    return StepTimes(tuple(paces), sum(compiling.values()) + again, plain_step, plain_program)


def shares_alive(plan: Plan, points: int) -> list[float]:
    """By phase, the mean share of the Gaussians at the end that are alive.

    Args:
        plan: The run.
        points: That it starts from.
    """
    density = plan.density
    if density.rule != "error":
        return [HALF_GROWN if phase.rule else 1.0 for phase in plan.phases]
    first = min(max(points, 1) / plan.max_gaussians, 1.0)
    growing = max(density.full_by * (density.stop - density.start), 1)
    missing = [
        1 - np.clip((np.arange(phase.begin, phase.end) + 1 - density.start) / growing, 0, 1) for phase in plan.phases
    ]
    return [float(np.mean(first**each)) if len(each) else 1.0 for each in missing]


class _EnoughError(Exception):
    """Steps have been timed for long enough."""


def _moments(
    scene: Scene, frames: Sequence[Frame], size: float, settings: Settings, plan: Plan, most: float, clock: Clock
) -> list[float]:
    """When the steps of the plan's only phase ended, and before them when the first one began."""
    (phase,) = plan.phases
    # Nobody multiplies while the steps are timed; the statistics for it are gathered all the same.
    still = replace(plan.density, start=phase.steps + 1, stop=phase.steps + 2, reset_every=0)
    optimizer = optimizers.make_optimizer(plan.rates, size, phase.steps)
    state = initial_state(_grown(scene, settings), optimizer, rule_named(plan.density.rule))
    moments = [clock()]

    def note(progress: Progress) -> None:
        del progress
        moments.append(clock())
        if len(moments) > WARM + 2 and moments[-1] - moments[WARM] > most:
            raise _EnoughError

    def facing(_: object) -> list[np.ndarray]:
        return [np.tile(np.int8([0, 0, -NORMAL_UNIT]), (frame.height, frame.width, 1)) for frame in frames]

    def far(scale: int) -> list[tuple[np.ndarray, np.ndarray]]:
        shapes = [(frame.height // scale, frame.width // scale) for frame in frames]
        return [(np.ones(shape, np.float32), np.full(shape, 255, np.uint8)) for shape in shapes]

    with contextlib.suppress(_EnoughError):
        still_plan = replace(plan, density=still)
        loop.follow(loop.Work(still_plan, frames, size, optimizer, facing, note, depths=far), state)
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


def step_cost(gaussians: float) -> float:
    """A step with so many times the Gaussians, in steps with all of them."""
    return 1 - PER_GAUSSIAN * (1 - gaussians)


def largest_scale(plan: Plan) -> int:
    """How many times smaller the largest photos are that any phase looks at."""
    return min(phase.scale for phase in plan.phases)
