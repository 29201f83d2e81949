"""Where does a training step's time go? Processor time of its parts, with the native loops and with the jnp engine.

    python experiments/benchmarks/step_profile.py RUN [--rounds 15] [--processes 3]

The Gaussians of RUN, a finished run, seen in its first photo. Every part is a program of its own: it and the whole step
run in turn with either engine, one first in one round and the other in the next. Parts do not add up to the step to the
millisecond, since XLA fuses across them. A ratio is jnp's time over the loops', the median over the rounds; the process
with the least time for the whole step is reported, and the range of its ratio over all processes.
"""

import argparse
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from gsjax.cli import run_guarded
from gsjax.io.machine import machine, versions
from gsjax.report import tables

ENGINES = ("native", "xla")


@contextmanager
def traced_with(engine: str) -> Iterator[None]:
    """Within, "auto" means an engine, in whatever is traced."""
    from rasterizer import engines

    original = engines.resolve
    engines.resolve = lambda backend: engine if backend == "auto" else original(backend)
    try:
        yield
    finally:
        engines.resolve = original


def parts(run: Path) -> dict[str, Callable[[], Any]]:
    """By part of a step, and by phase of the preset `fast` for whole ones: what computes it once."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    import rasterizer
    from gsjax import rendering
    from gsjax.metrics.images import ssim
    from gsjax.planning.sizes import training_extent
    from gsjax.presets import preset
    from gsjax.runs.result import open_result, scene_of_run
    from gsjax.scene import batches
    from gsjax.settings import Rates
    from gsjax.training import optimizers
    from gsjax.training.capacity import chosen_capacity
    from gsjax.training.stepping import one_view

    scene = scene_of_run(run)
    finished = jax.tree.map(np.asarray, open_result(run).gaussians)  # Steps donate what they begin from.
    gaussians = jax.tree.map(jnp.asarray, finished)
    data = batches.read_batches(scene.train_frames)
    batch = batches.decode(one_view(data, 0, 0.5)(0), jnp.ones(3, jnp.float32))
    camera, capacity, grid = batch.camera, chosen_capacity(gaussians, data), rendering.tile_grid(batch.camera)

    def projected(gaussians):
        scene = rendering.drawable(gaussians)
        return *rendering.projected(scene, camera, "center"), rendering.colors(scene, camera)

    def summed(gaussians):
        projection, opacities, colors = projected(gaussians)
        return sum(jnp.sum(x) for x in (projection.means2d, projection.conics, opacities, colors))

    def listed(projection, opacities):
        return rasterizer.bin_splats(projection, opacities, grid, capacity, rasterizer.GSPLAT)

    def blended(inputs, projection, pairs):
        means2d, conics, opacities, colors = inputs
        placed = projection._replace(means2d=means2d, conics=conics)
        return jnp.sum(rasterizer.blend(placed, opacities, colors[None], pairs, grid)[0] ** 2)

    def loss(picture):
        return 0.8 * jnp.mean(jnp.abs(picture - batch.image)) + 0.2 * (1 - ssim(picture, batch.image))

    optimizer = optimizers.make_optimizer(Rates(), 1.0, 1000)
    projection, opacities, colors = jax.jit(projected)(gaussians)
    blendable = (projection.means2d, projection.conics, opacities, colors), projection, listed(projection, opacities)
    programs = {
        "projection and harmonics, with gradients": (jax.grad(summed), (gaussians,)),
        "lists": (listed, (projection, opacities)),
        "blending": (blended, blendable),
        "blending, with gradients": (jax.grad(blended), blendable),
        "L1 and D-SSIM, with gradients": (jax.grad(loss), (0.9 * batch.image,)),
        "Adam, on copies of its arguments": (
            lambda parameters, state, *how: optimizers.apply_gradients(parameters, state, optimizer, *how),
            (gaussians, optimizer.init(gaussians), gaussians, jnp.bool_(False)),
        ),
    }
    whole = steppers(preset("fast"), finished, scene.train_frames, training_extent(scene))

    def compiled(function, arguments):
        program = jax.jit(function)
        jax.block_until_ready(program(*arguments))
        return lambda: jax.block_until_ready(program(*arguments))

    steps = {f"a whole step, {phase}": once for phase, once in whole.items()}
    return {name: compiled(*program) for name, program in programs.items()} | steps


def steppers(settings: Any, gaussians: Any, frames: Any, extent: float) -> dict[str, Callable[[], Any]]:
    """By phase: takes one step, and the next when called again."""
    import jax
    import numpy as np

    from gsjax.scene import batches
    from gsjax.training.capacity import chosen_capacity
    from gsjax.training.densification.rules import DENSIFICATION_RULES
    from gsjax.training.optimizers import make_optimizer
    from gsjax.training.plan import plan
    from gsjax.training.state import initial_state
    from gsjax.training.step import BACKGROUNDS, make_train_step
    from gsjax.training.stepping import one_view
    from gsjax.training.terms.multi_view import with_neighbors

    optimizer, key = make_optimizer(settings.rates, extent, settings.schedule.steps), jax.random.key(0)
    facing = [np.tile(np.array([0, 0, -127], np.int8), (frame.height, frame.width, 1)) for frame in frames]
    by_phase = {}
    for phase in plan(settings).phases:
        scale = phase.scale * phase.surface_scale
        data = with_neighbors(batches.read_batches(frames, scale=scale), extent)
        if "normals" in phase.needs:
            data = batches.with_normals(data, facing, scale)
        if "measured" in phase.needs:
            ones = np.ones(data.size[::-1], np.float32)
            data = batches.with_depths(data, [(ones, 255 * ones.astype(np.uint8))] * len(frames))
        rule = DENSIFICATION_RULES[settings.density.rule]
        start = replace(jax.tree.map(jax.numpy.asarray, gaussians), pixel_filter=settings.model.pixel_filter)
        state = initial_state(start, optimizer, rule)
        step = make_train_step(
            optimizer,
            tuple(each for each in phase.terms if data.has_mattes or each.name != "alpha"),
            capacity=chosen_capacity(start, data),
            background=BACKGROUNDS[settings.model.background],
            sh_every=1,
            rule=phase.rule,
            depth_mode=settings.model.depth_mode,
            extent=extent,
        )
        by_phase[phase.name] = _stepper(step, state, one_view(data, 0, 0.5)(0), key)
    return by_phase


def _stepper(step: Callable, state: Any, target: Any, key: Any) -> Callable[[], Any]:
    import jax

    def once() -> Any:
        nonlocal state
        state, metrics = jax.block_until_ready(step(state, target, key))
        return metrics

    once()  # compiles
    return once


def measure(run: Path, rounds: int) -> dict[str, list[float]]:
    """By part: milliseconds of the processor with the loops and with jnp, and the median ratio of the two."""
    import numpy as np

    from gsjax.cli.environment import keep_memory

    keep_memory()  # As the commands do.
    both = {}
    for engine in ENGINES:
        with traced_with(engine):
            both[engine] = parts(run)
    times: dict[tuple[str, str], list[float]] = {(engine, part): [] for engine in ENGINES for part in both[engine]}
    for round_ in range(rounds):
        for part in both[ENGINES[0]]:
            for engine in ENGINES[:: 1 if round_ % 2 else -1]:  # Who comes second finds the caches warm.
                started = time.process_time()
                both[engine][part]()
                times[engine, part].append(1e3 * (time.process_time() - started))
    ratios = {part: np.array(times["xla", part]) / np.array(times["native", part]) for part in both["native"]}
    return {
        part: [*(float(np.median(times[engine, part])) for engine in ENGINES), float(np.median(ratio))]
        for part, ratio in ratios.items()
    }


def main() -> None:
    """Measure and print one table, with machine and versions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--processes", type=int, default=3)
    arguments = parser.parse_args()
    measurements = []
    for _ in range(arguments.processes):
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), max_tasks_per_child=1) as pool:
            measurements.append(pool.submit(measure, arguments.run, arguments.rounds).result())
    quickest = min(measurements, key=lambda each: sum(figures[0] for figures in each.values()))
    rows = {}
    for part, (native, xla, ratio) in quickest.items():
        others = [each[part][2] for each in measurements]
        rows[part] = {
            "native, ms": f"{native:.1f}",
            "jnp, ms": f"{xla:.1f}",
            "jnp / native": f"{ratio:.2f} ({min(others):.2f}-{max(others):.2f})",
        }
    print(tables.compare(rows))
    print(tables.record({"rounds": arguments.rounds, "processes": arguments.processes, **machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
