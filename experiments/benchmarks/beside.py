"""Our tile rasterizer beside another one, in turn within the same processes: ratios hold on a machine that is shared.

    python experiments/benchmarks/beside.py PEER.py | gsplat [--rounds 15] [--processes 5]

Ours bins and blends the splats of one view, forward and with the gradients to all of them; `peers.py` says what the
others do. Their images must agree. A row a process: it keeps its luck with memory and neighbours, so the quickest and
the slowest of the day are both told.
"""

import argparse
import multiprocessing
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from peers import TILE, Peer, Splats, Task, peer_named
from workloads import GOLDEN, WORKLOADS, scene_named

from gsjax import tables
from gsjax.cli import guarded
from gsjax.errors import InputError

NAMES = ("golden: 10k, 256x256, radius 6", "100k, 512x512, radius 3")
SAME = 1e-5  # mean difference of the colours: a splat on the alpha cut may be drawn by one alone
PARTS = ("forward", "both")


def tasks(name: str, peer: Peer) -> tuple[tuple[Task, Task], tuple[Task, Task]]:
    """(ours, the peer's): what each does with the splats of a workload, forward and with gradients, compiled."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    import rasterizer

    (means, quats, scales, opacities, colors, *cameras), width, height = scene_named(name)
    projection = rasterizer.project(means, quats, scales, opacities, *cameras, width, height, rules=peer.rules)
    grid = rasterizer.TileGrid(1, width, height, TILE)
    count = int(rasterizer.count_pairs(projection, grid))
    inputs = projection.means2d, projection.conics, opacities, colors

    # All that is known of the splats is an argument: a compiler sorts constants before the clock starts.
    def image(inputs, projection):
        means2d, conics, opacities, colors = inputs
        placed = projection._replace(means2d=means2d, conics=conics)
        pairs = rasterizer.bin_splats(placed, opacities, grid, count, peer.rules)
        return rasterizer.blend(placed, opacities, colors[None], pairs, grid, rules=peer.rules)[0][0]

    compiled = jax.jit(image), jax.jit(jax.grad(lambda *arguments: jnp.sum(image(*arguments) ** 2)))
    ours = tuple(lambda run=run: jax.block_until_ready(run(inputs, projection)) for run in compiled)
    pairs = rasterizer.bin_splats(projection, opacities, grid, count, peer.rules)
    theirs = peer.tasks(Splats(projection, opacities, colors, grid, pairs))
    off = float(np.abs(np.asarray(ours[0]()) - np.asarray(theirs[0]())).mean())
    if off > SAME:
        raise InputError(f"{name}: the images differ by {off:.2g} in the mean: the peer draws something else")
    return ours, theirs  # pyright: ignore[reportReturnType]


def measure(name: str, peer: str, rounds: int) -> dict[str, str]:
    """A row: milliseconds of ours, and the peer's in times of ours, median and the middle half over the rounds."""
    import jax
    import numpy as np

    jax.config.update("jax_enable_compilation_cache", False)
    row = {}
    for part, both in zip(PARTS, zip(*tasks(name, peer_named(peer)), strict=True), strict=True):
        spans = np.array([[_seconds(task) for task in both] for _ in range(rounds + 1)])[1:]
        low, middle, high = np.quantile(spans[:, 1] / spans[:, 0], [0.25, 0.5, 0.75])
        row[f"{part}, ms"] = f"{1e3 * np.median(spans[:, 0]):.1f}"
        row[f"{part}, the peer's"] = f"{middle:.2f} ({low:.2f}-{high:.2f})"
    return row


def _seconds(task: Task) -> float:
    started = time.perf_counter()
    task()
    return time.perf_counter() - started


def main() -> None:
    """Measure and print one table a workload, with machine and versions."""
    # Run as a script, this folder holds a file of the package's name.
    sys.path.sort(key=lambda folder: Path(folder).resolve() == Path(__file__).resolve().parent)
    from gsjax.io.machine import machine, versions

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("peer", metavar="PEER", help="a Python file, or gsplat for its torch reference")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--processes", type=int, default=5)
    arguments = parser.parse_args()
    peer_named(arguments.peer)
    for name in [name for name in NAMES if name in WORKLOADS or GOLDEN.is_file()]:
        rows = []
        for _ in range(arguments.processes):
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), max_tasks_per_child=1) as pool:
                rows.append(pool.submit(measure, name, arguments.peer, arguments.rounds).result())
        rows.sort(key=lambda row: float(row["both, ms"]))
        print(f"{name}; processes, the quickest first")
        print(tables.compare({str(place): row for place, row in enumerate(rows, 1)}))
    print(tables.record({"rounds": arguments.rounds, **machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(guarded(main))
