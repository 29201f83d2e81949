"""Our tile rasterizer beside another one, in turn within the same processes: ratios hold on a machine that is shared.

    python experiments/benchmarks/beside.py PEER.py [--rounds 15] [--processes 5]

PEER.py has `bin_pairs`, `forward` and `backward` of projected splats in JAX: three channels, groups of tiles in
lockstep. Both bin and blend the same splats, forward and with the gradients to all of them; their images must agree. A
row a process: it keeps its luck with memory and neighbours, so the quickest and the slowest of the day are both told.
"""

import argparse
import importlib.util
import multiprocessing
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from workloads import GOLDEN, WORKLOADS, scene_named

from gsjax import tables
from gsjax.cli import guarded
from gsjax.errors import InputError

TILE, LANES = 8, 256  # pixels, tiles: the peer's fastest
NAMES = ("golden: 10k, 256x256, radius 6", "100k, 512x512, radius 3")
SAME = 1e-5  # mean difference of the colours: a splat on the alpha cut may be drawn by one alone

Task = Callable[[], Any]


def tasks(name: str, peer: Any) -> tuple[dict[str, Task], dict[str, Task]]:
    """(ours, the peer's): what each does with the splats of a workload, forward and with gradients, compiled."""
    import jax
    import jax.numpy as jnp

    import rasterizer

    (means, quats, scales, opacities, colors, *cameras), width, height = scene_named(name)
    projection = rasterizer.project(means, quats, scales, opacities, *cameras, width, height)
    grid = rasterizer.TileGrid(1, width, height, TILE)
    count = int(rasterizer.count_pairs(projection, grid))
    splats = projection.means2d, projection.conics, opacities, colors

    def image(splats):
        means2d, conics, opacities, colors = splats
        placed = projection._replace(means2d=means2d, conics=conics)
        pairs = rasterizer.bin_splats(placed, opacities, grid, count, rasterizer.GSPLAT)
        return rasterizer.blend(placed, opacities, colors[None], pairs, grid)[0][0]

    across, down = -(-width // TILE), -(-height // TILE)
    where = projection.means2d[0], projection.depths[0], projection.extents[0], projection.visible[0]
    needed = int(peer.bin_pairs(*where, across, down, 1, TILE)[2])

    def blended(splats):
        means2d, conics, opacities, colors = splats
        params = jnp.concatenate([means2d[0], conics[0], opacities[:, None], colors], -1)
        pairs, offsets, _ = peer.bin_pairs(means2d[0], *where[1:], across, down, needed, TILE)
        return params, pairs, offsets, peer.forward(params, pairs, offsets, across, down, LANES, TILE)

    def peers_image(splats):
        tiles = blended(splats)[3][0].reshape(down, across, 3, TILE, TILE)
        return tiles.transpose(0, 3, 1, 4, 2).reshape(down * TILE, across * TILE, 3)[:height, :width]

    def peers_gradient(splats):
        params, pairs, offsets, (lit, left, last) = blended(splats)
        return peer.backward(params, pairs, offsets, left, last, 2 * lit, 0 * left, across, down, LANES, TILE)

    off = float(jnp.abs(image(splats) - peers_image(splats)).mean())
    if off > SAME:
        raise InputError(f"{name}: the images differ by {off:.2g} in the mean: the peer draws something else")
    ours = jax.jit(image), jax.jit(jax.grad(lambda splats: jnp.sum(image(splats) ** 2)))
    theirs = jax.jit(peers_image), jax.jit(peers_gradient)
    return tuple(
        {part: lambda f=f: jax.block_until_ready(f(splats)) for part, f in zip(("forward", "both"), each, strict=True)}
        for each in (ours, theirs)
    )  # pyright: ignore[reportReturnType]


def measure(name: str, file: Path, rounds: int) -> dict[str, str]:
    """A row: milliseconds of ours, and the peer's in times of ours, median and the middle half over the rounds."""
    import jax
    import numpy as np

    jax.config.update("jax_enable_compilation_cache", False)
    row = {}
    ours, theirs = tasks(name, _imported(file))
    for part in ours:
        spans = np.array([[_seconds(task[part]) for task in (ours, theirs)] for _ in range(rounds + 1)])[1:]
        low, middle, high = np.quantile(spans[:, 1] / spans[:, 0], [0.25, 0.5, 0.75])
        row[f"{part}, ms"] = f"{1e3 * np.median(spans[:, 0]):.1f}"
        row[f"{part}, the peer's"] = f"{middle:.2f} ({low:.2f}-{high:.2f})"
    return row


def _seconds(task: Task) -> float:
    started = time.perf_counter()
    task()
    return time.perf_counter() - started


def _imported(file: Path) -> Any:
    """The peer's module."""
    spec = importlib.util.spec_from_file_location(file.stem, file)
    if spec is None or spec.loader is None or not file.is_file():
        raise InputError(f"{file}: no Python file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main() -> None:
    """Measure and print one table a workload, with machine and versions."""
    # Run as a script, this folder holds a file of the package's name.
    sys.path.sort(key=lambda folder: Path(folder).resolve() == Path(__file__).resolve().parent)
    from gsjax.io.machine import machine, versions

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("peer", type=Path)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--processes", type=int, default=5)
    arguments = parser.parse_args()
    _imported(arguments.peer)
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
