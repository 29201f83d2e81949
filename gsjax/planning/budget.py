"""A run for a given time: which preset, and how many of its steps and Gaussians fit on this machine."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.planning.pace import FIXED_COST, TIMED, UNTIMED, relative_cost
from gsjax.planning.sizes import at_size, training_extent
from gsjax.presets import LENGTHS
from gsjax.scene import Scene, preload
from gsjax.scene.batches import NORMAL_UNIT
from gsjax.settings import Model, Settings
from gsjax.training import initialize, loop, optimizers
from gsjax.training.plan import Plan, plan
from gsjax.training.state import initial_state

RESERVED = 0.2  # of a budget: photos, effects, validation runs, the run's own normals, scores
SHORTENED = 0.4  # A preset with less of its time than this is no better than a shorter one (docs/accuracy_vs_time.md).
FEWEST_STEPS = 50  # of a run
FEWEST_ROUNDS, SHORTEST_INTERVAL = 8, 20  # of densification, and steps between two of them
PER_GAUSSIAN = 0.7  # of a step's time, what grows with the number of Gaussians (docs/accuracy_vs_time.md)
PHOTOS = 8  # that the measured steps see, at most
GROWN = 10  # times the point cloud: Gaussians at the end where the densification rule names no number
WIDENED = 1.4  # by training, at most, against Gaussians that are initialised as densely


def scaled(settings: Settings, factor: float) -> Settings:
    """The same run in `factor` times as many steps: phases, and all that is due at a step, in proportion.

    The interval of densification never grows, and by error it shrinks only as far as `FEWEST_ROUNDS` need.
    """

    def times(steps: int | None) -> int | None:
        return max(1, round(factor * steps)) if steps else steps

    every, named = settings.density.every, ("start", "stop", "reset_every")
    density = replace(settings.density, **{name: times(getattr(settings.density, name)) for name in named})
    # Gaussians that moved by error need steps until they fit; 3DGS's rule grows more by more rounds.
    shortest = (density.stop - density.start) // FEWEST_ROUNDS if density.rule == "error" else 0
    return settings.replace(
        rates=replace(settings.rates, decay_steps=times(settings.rates.decay_steps)),
        density=replace(density, every=min(every, max(SHORTEST_INTERVAL, round(factor * every), shortest))),
        schedule={
            "phases": tuple(replace(phase, steps=times(phase.steps)) for phase in settings.schedule.phases),
            "sh_every": times(settings.schedule.sh_every),
        },
    )


def resized(settings: Settings, factor: float) -> Settings:
    """A run of `factor` times the time: its square root times the Gaussians, and the steps that fill the rest."""
    if settings.density.rule != "error":  # 3DGS's rule has no number of Gaussians to reach.
        return scaled(settings, factor)
    gaussians = math.sqrt(factor)
    shorter = scaled(settings, factor / (1 - PER_GAUSSIAN * (1 - gaussians)))
    return shorter.replace(model={"max_gaussians": max(1, round(gaussians * settings.model.max_gaussians))})


def budgeted(
    scene: str | Path,
    candidates: Mapping[str, Settings],
    seconds: float,
    lasting: Callable[[Settings, float], Settings] = resized,
) -> tuple[Settings, str]:
    """The settings of a run that takes `seconds`, measuring included, and a line that says what was chosen.

    Args:
        scene: Folder of the data set.
        candidates: Runs by their names, the shortest first. The longest of which `SHORTENED` fits is taken.
        seconds: The budget.
        lasting: (run, factor) -> the run that takes so many times its time: `resized`, or `scaled` in steps alone.

    Raises:
        InputError: The data set cannot be used, or the budget is too short for any candidate.
    """
    began, scenes, plans = time.perf_counter(), {}, {}
    for name, settings in candidates.items():
        scenes[name], downscale, _ = at_size(scene, settings.photos, settings.schedule.steps)
        plans[name] = replace(plan(settings), downscale=downscale)

    def measure_run(name: str) -> tuple[float, float]:
        return measure(scenes[name], plans[name], candidates[name].model)

    name = next(iter(candidates))
    whole, compiling = measure_run(name)
    units = {other: _units(each, plans[name]) for other, each in plans.items()}
    fitting = (other for other in units if SHORTENED * whole * units[other] <= seconds * units[name])
    longest = max(fitting, key=units.__getitem__, default=name)
    if longest != name:
        name = longest
        whole, compiling = measure_run(name)
    settings = candidates[name].replace(photos={"downscale": plans[name].downscale})
    spent = time.perf_counter() - began + compiling  # The run compiles its own programs.
    part = max(((1 - RESERVED) * seconds - spent) / whole, 0.0)
    run_settings = lasting(settings, min(part, 1.0) if name == LENGTHS[-1] else part)
    if run_settings.schedule.steps < FEWEST_STEPS:
        least = math.ceil((spent + FEWEST_STEPS * whole / settings.schedule.steps) / (1 - RESERVED))
        raise InputError(
            f"a budget of {seconds:g} s is too short: even {FEWEST_STEPS} steps take {least} s here in all"
        )
    gaussians = f"up to {run_settings.model.max_gaussians:,} Gaussians"
    return run_settings, f"{name} in {run_settings.schedule.steps:,} steps, with {gaussians}"


def measure(scene: Scene, planned: Plan, model: Model) -> tuple[float, float]:
    """Seconds of all steps of a run and of compiling, by the first steps of each phase on a few of its photos.

    They have the Gaussians of the run's end, so that phases in which Gaussians multiply take less than measured.
    """
    size, steps = training_extent(scene), UNTIMED + TIMED
    frames = [preload(frame) for frame in scene.train_frames[:: -(-len(scene.train_frames) // PHOTOS)]]
    ends = [steps * number for number, _ in enumerate(planned.phases, 1)]
    pairs = zip(planned.phases, ends, strict=True)
    phases = tuple(replace(phase, begin=end - steps, end=end, cull_below=0.0) for phase, end in pairs)
    # Gaussians do not multiply meanwhile; the statistics for it are gathered all the same.
    density = replace(planned.density, start=ends[-1] + 1, stop=ends[-1] + 2, reset_every=0)
    optimizer = optimizers.make_optimizer(planned.rates, size, planned.rates.decay_steps)
    state = initial_state(_grown(scene, model, planned.density.rule), optimizer, planned.rule)

    def maps(value: float, dtype: type, scale: int, *channels: int) -> list[np.ndarray]:
        return [np.full((each.height // scale, each.width // scale, *channels), value, dtype) for each in frames]

    moments = [time.perf_counter()]
    work = loop.Work(
        replace(planned, phases=phases, density=density),
        frames,
        size,
        optimizer,
        normal_source=lambda _: maps(-NORMAL_UNIT / math.sqrt(3), np.int8, 1, 3),  # all face the camera
        observe=lambda _: moments.append(time.perf_counter()),
        depths=lambda scale: zip(maps(1, np.float32, scale), maps(255, np.uint8, scale), strict=True),
    )
    loop.follow(work, state)
    halves = np.diff(moments).reshape(len(phases), steps)[:, UNTIMED:].reshape(len(phases), 2, -1)
    paces = halves.mean(-1).min(-1)  # of the faster half: in the other a buffer may have grown
    compiling = moments[-1] - moments[0] - steps * paces.sum()
    return float(np.dot([phase.steps for phase in planned.phases], paces)), float(compiling)


def _grown(scene: Scene, model: Model, rule: str) -> Gaussians:
    """As many Gaussians as the run ends with, about the points of the scene."""
    points, most = scene.points, model.max_gaussians
    count = most if rule == "error" else min(most, GROWN * len(points))
    indices = np.resize(np.random.default_rng(0).permutation(len(points)), count)
    spacing = KDTree(points).query(points, min(4, len(points)))[0].reshape(len(points), -1)[indices, -1:]
    means = points[indices] + np.random.default_rng(1).normal(size=(count, 3)) * spacing / 2
    how = {"sh_degree": model.sh_degree, "pixel_filter": model.pixel_filter, "opacity": 0.5}
    gaussians = initialize.from_points(means.astype(np.float32), scene.point_colors[indices], capacity=count, **how)
    return replace(gaussians, log_scales=gaussians.log_scales + math.log(WIDENED))


def _units(planned: Plan, other: Plan) -> float:
    """All steps of a run, in plain steps of another one on the same photos."""
    pixels = (other.downscale / planned.downscale) ** 2
    step = FIXED_COST * planned.max_gaussians / other.max_gaussians + (1 - FIXED_COST) * pixels
    return step * sum(phase.steps * relative_cost(phase) for phase in planned.phases)
