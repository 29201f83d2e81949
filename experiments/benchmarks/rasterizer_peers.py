"""How fast is our tile rasterizer against another one? In turn in one process, so ratios hold on a shared machine.

    python experiments/benchmarks/rasterizer_peers.py gsplat | jnp [--run RUN] [--rounds 15] [--processes 5]

Ours, the backend that `auto` means, bins and blends the splats of one view, forward and with the gradients to all
of them; `peers.py` says what the others do. Their images must match. The peer's wall time and its processor time are
reported in times of ours; the second holds even where other programs want the same cores. A row a process: it keeps its
luck with memory and neighbours, so the quickest and the slowest of the day are both reported.

With a finished run, what its first training camera sees of its Gaussians is one more workload.
"""

import argparse
import multiprocessing
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from peers import TILE, Peer, Splats, Task, peer_named, tasks_of_ours
from workloads import GOLDEN, HEAVY, workload_views

from gsjax.cli import run_guarded
from gsjax.errors import InputError
from gsjax.report import tables

NAMES = ("golden: 10k, 256x256, radius 6", "100k, 512x512, radius 3", HEAVY)
# Mean difference of the colours: a splat on the alpha cut, or one that makes a pixel opaque, may be drawn by one alone.
SAME = 1e-4
PARTS = ("forward", "both")
CLOCKS = {"wall": time.perf_counter, "processor": time.process_time}


def tasks(workload: str | Path, peer: Peer) -> tuple[tuple[Task, Task], tuple[Task, Task]]:
    """(ours, the peer's): what each does with the splats of a workload, forward and with gradients, compiled."""
    import numpy as np

    import rasterizer

    projection, opacities, colors, width, height = workload_views(workload, peer.rules)
    grid = rasterizer.TileGrid(1, width, height, TILE)
    capacity = int(rasterizer.count_pairs(projection, grid))
    pairs = rasterizer.bin_splats(projection, opacities, grid, capacity, peer.rules)
    splats = Splats(projection, opacities, colors, grid, pairs)
    ours, theirs = tasks_of_ours(splats, backend="auto", rules=peer.rules), peer.tasks(splats)
    off = float(np.abs(np.asarray(ours[0]()) - np.asarray(theirs[0]())).mean())
    if off > SAME:
        raise InputError(f"{workload}: the images differ by {off:.2g} in the mean: the peer draws something else")
    return ours, theirs


def measure(workload: str | Path, peer: str, rounds: int) -> dict[str, str]:
    """A row: milliseconds of ours, and the peer's in times of ours, median and the middle half over the rounds."""
    import jax
    import numpy as np

    jax.config.update("jax_enable_compilation_cache", False)
    row = {}
    for part, both in zip(PARTS, zip(*tasks(workload, peer_named(peer)), strict=True), strict=True):
        spans = np.array([[_seconds(task) for task in both] for _ in range(rounds + 1)])[1:]  # [round, whose, clock]
        row[f"{part}, ms"] = f"{1e3 * np.median(spans[:, 0, 0]):.1f}"
        for clock, ratios in zip(CLOCKS, (spans[:, 1] / spans[:, 0]).T, strict=True):
            low, middle, high = np.quantile(ratios, [0.25, 0.5, 0.75])
            row[f"{part}, the peer's {clock}"] = f"{middle:.2f} ({low:.2f}-{high:.2f})"
    return row


def _seconds(task: Task) -> list[float]:
    """How long a task takes by each clock."""
    started = [now() for now in CLOCKS.values()]
    task()
    return [now() - then for now, then in zip(CLOCKS.values(), started, strict=True)]


def main() -> None:
    """Measure and print one table a workload, with machine and versions."""
    # Run as a script, this folder holds a file of the package's name.
    sys.path.sort(key=lambda folder: Path(folder).resolve() == Path(__file__).resolve().parent)
    from gsjax.io.machine import machine, versions

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("peer", choices=("gsplat", "jnp"), help="gsplat's torch reference, or our own engine in jnp")
    parser.add_argument("--run", type=Path, help="a finished run, for one more workload")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--processes", type=int, default=5)
    arguments = parser.parse_args()
    peer_named(arguments.peer)
    workloads: list[str | Path] = [name for name in NAMES if not name.startswith("golden") or GOLDEN.is_file()]
    if arguments.run:
        from gsjax.runs.result import open_result

        open_result(arguments.run)  # What is wrong with it is said before the clock starts.
        workloads.append(arguments.run)
    for workload in workloads:
        rows = []
        for _ in range(arguments.processes):
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), max_tasks_per_child=1) as pool:
                rows.append(pool.submit(measure, workload, arguments.peer, arguments.rounds).result())
        rows.sort(key=lambda row: float(row["both, ms"]))
        print(f"{workload}; processes, the quickest first")
        print(tables.compare({str(place): row for place, row in enumerate(rows, 1)}))
    print(tables.record({"rounds": arguments.rounds, **machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
