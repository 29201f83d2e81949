"""How long does every stage of the tile rasterizer take on seeded workloads? Tables with the machine.

    python experiments/benchmarks/rasterizer_cpu.py [--backend native | xla] [--only WORKLOAD] [--processes 3]

A nanosecond figure is blending's time by (pixel, Gaussian) pairs: Gaussians listed for a tile times all of its pixels,
whether they draw them or not. All are wall times: no other program may use the cores.
"""

import argparse
import multiprocessing
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

from workloads import GOLDEN, HEAVY, WORKLOADS, milliseconds, programs, scene_named

from gsjax.cli import run_guarded
from gsjax.io.machine import peak_memory
from gsjax.report import tables

# A process keeps its luck with memory and neighbours from the first call to the last, up to a factor of two.
PROCESSES = 3


def measure(name: str, backend: Any) -> dict[str, float]:
    """Figures of a backend on one workload; meant for a process of its own, whose peak memory is part of them."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_compilation_cache", False)  # Or compile times would be those of reading a file.
    scene = scene_named(name)
    arrays, (projected, binned, image, pairs, pixel_pairs) = scene.arrays, programs(scene, backend)

    def projection_gradient(arrays):
        return jax.grad(lambda a: sum(jnp.sum(x) for x in (projected(a).means2d, projected(a).conics)))(arrays)

    _, projection = milliseconds(jax.jit(projected), arrays)
    _, binning = milliseconds(jax.jit(binned), arrays)
    _, forward = milliseconds(jax.jit(image), arrays)
    _, both_of_projection = milliseconds(jax.jit(projection_gradient), arrays)
    first, both = milliseconds(jax.jit(jax.grad(lambda a: jnp.sum(image(a) ** 2))), arrays)
    projection_backward = max(both_of_projection - projection, 0)
    return {
        "pairs": pairs,
        "projection": projection,
        "binning": binning - projection,
        "blending": forward - binning,
        "blending_backward": both - forward - projection_backward,
        "projection_backward": projection_backward,
        "forward_ms": forward,
        "forward_backward_ms": both,
        "forward_ns": 1e6 * (forward - binning) / pixel_pairs,
        "backward_ns": 1e6 * (both - forward - projection_backward) / pixel_pairs,
        "compile_s": (first - both) / 1e3,
        "peak_mib": peak_memory() / 2**20,
    }


def main(argv: Sequence[str] | None = None) -> None:
    """Measure and print."""
    from gsjax.io.machine import machine, versions

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [*(["golden: 10k, 256x256, radius 6"] if GOLDEN.is_file() else []), *WORKLOADS, HEAVY]
    parser.add_argument("--backend", choices=("native", "xla"), help="what is timed (default: what auto means)")
    parser.add_argument("--only", choices=names, help="one workload")
    parser.add_argument("--processes", type=int, default=PROCESSES, metavar="N", help="of which the quickest counts")
    arguments = parser.parse_args(argv)
    from rasterizer.engines import resolve

    backend = arguments.backend or resolve("auto")
    rows = {}
    for name in [arguments.only] if arguments.only else names:
        # Processes of their own, so that each has its own peak of memory; the quickest counts.
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, spawn, max_tasks_per_child=1) as pool:
            figures = list(pool.map(partial(measure, backend=backend), [name] * arguments.processes))
        rows[name] = min(figures, key=lambda row: row["forward_backward_ms"])
    print(tables.compare(rows))
    print(tables.record({"backend": backend, **machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
