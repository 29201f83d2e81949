"""What does a training step of every variant of a study cost? Processor time against the first one's, in turn.

    python experiments/benchmarks/step_cost.py STUDY RUN [--on CONFIG] [--rounds 15]

All start from the Gaussians of RUN, a finished run, and look at its first photo and at normals that face the camera; a
column a phase. Ratios are medians over the rounds, with the quarter and three quarters of them.
"""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from gsjax import tables
from gsjax.cli import run_guarded
from gsjax.io.machine import machine, versions


def steppers(settings: Any, gaussians: Any, frames: Any, extent: float) -> dict[str, Callable[[], Any]]:
    """By phase: takes one step, and the next when called again."""
    import jax
    import numpy as np

    from gsjax import targets
    from gsjax.settings import total_steps
    from gsjax.training.capacity import chosen_capacity
    from gsjax.training.growth.rules import RULES
    from gsjax.training.optimizers import make_optimizer
    from gsjax.training.plan import plan
    from gsjax.training.state import initial_state
    from gsjax.training.step import BACKGROUNDS, make_train_step
    from gsjax.training.stepping import one_view
    from gsjax.training.terms.multi_view import with_neighbors

    optimizer, key = make_optimizer(settings.rates, extent, total_steps(settings)), jax.random.key(0)
    facing = [np.tile(np.array([0, 0, -127], np.int8), (frame.height, frame.width, 1)) for frame in frames]
    taken = {}
    for phase in plan(settings).phases:
        scale = phase.scale * phase.surface_scale
        data = with_neighbors(targets.read_targets(frames, scale=scale), extent)
        if "normals" in phase.needs:
            data = targets.with_normals(data, facing, scale)
        rule = RULES[settings.density.rule]
        start = replace(jax.tree.map(jax.numpy.asarray, gaussians), pixel_filter=settings.pixel_filter)
        state = initial_state(start, optimizer, rule)
        step = make_train_step(
            optimizer,
            tuple(each for each in phase.terms if data.has_mattes or each.name != "alpha"),
            capacity=chosen_capacity(start, data),
            background=BACKGROUNDS[settings.background],
            sh_every=1,
            rule=phase.rule,
            depth_mode=settings.depth_mode,
            extent=extent,
        )
        taken[phase.name] = _stepper(step, state, one_view(data, 0, 0.5)(0), key)
    return taken


def _stepper(step: Callable, state: Any, target: Any, key: Any) -> Callable[[], Any]:
    import jax

    def once() -> Any:
        nonlocal state
        state, metrics = jax.block_until_ready(step(state, target, key))
        return metrics

    once()  # compiles
    return once


def measure(study: str, run: Path, rounds: int, on: str | None = None) -> dict[str, dict[str, str]]:
    """By variant: milliseconds of the first, ratios of the others, a column a phase."""
    import numpy as np
    from compare import load_study

    from gsjax import config
    from gsjax.planning.sizes import training_extent
    from gsjax.runs.result import open_result, scene_of_run
    from gsjax.settings import Settings

    gaussians, scene = open_result(run).gaussians, scene_of_run(run)
    described = load_study(study, on)
    every = {}
    for variant, change in described.variants.items():
        settings = config.parse(Settings, config.merge(described.config, change), where=variant)
        for phase, once in steppers(settings, gaussians, scene.train_frames, training_extent(scene)).items():
            every[variant, phase] = once
    times: dict[tuple[str, str], list[float]] = {name: [] for name in every}
    for _ in range(rounds):
        for name, once in every.items():
            started = time.process_time()
            once()
            times[name].append(1e3 * (time.process_time() - started))
    first = next(iter(described.variants))
    table: dict[str, dict[str, str]] = {}
    for (variant, phase), spent in times.items():
        low, middle, high = np.quantile(np.array(spent) / times[first, phase], [0.25, 0.5, 0.75])
        told = f"{np.median(spent):.1f} ms" if variant == first else f"{middle:.2f} ({low:.2f}-{high:.2f})"
        table.setdefault(variant, {})[phase] = told
    return table


def main() -> None:
    """Measure and print one table, with machine and versions."""
    # A script beside this one has the name of the package; those that this one imports lie a folder up.
    here = Path(__file__).resolve().parent
    sys.path.sort(key=lambda folder: Path(folder).resolve() == here)
    sys.path.insert(0, str(here.parent))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", metavar="STUDY", help="as in compare.py")
    parser.add_argument("run", type=Path, metavar="RUN", help="a finished run")
    parser.add_argument("--on", metavar="CONFIG", help="of configs.py (default: the study's own)")
    parser.add_argument("--rounds", type=int, default=15)
    arguments = parser.parse_args()
    print(tables.compare(measure(arguments.study, arguments.run, arguments.rounds, arguments.on)))
    print(tables.record({"rounds": arguments.rounds, **machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
