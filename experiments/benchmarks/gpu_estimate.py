"""How long would the GPU kernels take on an H100, by the lists of real tiles? An estimate, nothing is measured.

    python experiments/benchmarks/gpu_estimate.py RUN... [--zoom 1 3]

RUN is a finished run, drawn from its first training camera; --zoom makes its picture so many times larger. Counted are
the splats that each tile of 16x16 pixels walks until its pixels have stopped. Instructions and registers are those of
`experiments/results/gpu_kernels.md`. A multiprocessor shares its instructions a cycle evenly among the programs that it
holds; none is faster than a lone warp, and waiting for memory is only in the share of its peak that it is given.
"""

import argparse
import heapq
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from workloads import HEAVY, Seen, seen

from gsjax import tables
from gsjax.cli import run_guarded

TILE = 16  # pixels
SEGMENT = 256  # splats
SMS, CLOCK = 132, 1.755e9  # of an H100 SXM under load
PEAK_SHARE = 0.6  # of four instructions a cycle
LONE = 0.5  # instructions a cycle of a program that is alone, a warp


class Kernel(NamedTuple):
    """What one of the kernels takes."""

    instructions: float  # a pixel and splat
    programs: int  # that a multiprocessor's registers hold


FORWARD, BACKWARD = Kernel(48.25, 14), Kernel(87.5, 21)


def walked(scene: Seen) -> tuple[np.ndarray, np.ndarray, int]:
    """`[T]` splats listed for each tile, `[T]` those that it walks back, and the slots of the pair buffer."""
    import jax.numpy as jnp

    import rasterizer
    from gsjax.training.capacity import STILL, rounded_capacity
    from rasterizer.compositing import Static
    from rasterizer.engines import _engine

    p, grid = scene.projection, rasterizer.TileGrid(1, scene.width, scene.height, TILE)
    capacity = rounded_capacity(int(rasterizer.count_pairs(p, grid)), STILL)
    pairs = rasterizer.bin_splats(p, scene.opacities, grid, capacity, rasterizer.GSPLAT)
    opacities = jnp.where(p.visible[0], scene.opacities.reshape(-1), 0)[:, None]
    rows = jnp.concatenate([p.means2d[0], p.conics[0], opacities, scene.colors.reshape(-1, 3)], -1)
    engine = _engine("auto")
    blended = engine.forward(Static(grid, rasterizer.GSPLAT, engine), rows, pairs.splats, pairs.offsets)
    return np.diff(pairs.offsets), np.asarray(blended.last).max(-1) + 1, capacity


def seconds(splats: Sequence[int], kernel: Kernel) -> float:
    """When the last program ends, each walking so many splats, begun in this order where there is room first."""
    per_splat = kernel.instructions * TILE**2 / 32
    waiting = [per_splat * count for count in reversed(list(splats)) if count]
    # Of every multiprocessor: the time it was looked at last, instructions that each of its programs has had since it
    # began, and those at which its programs end.
    looked, given = np.zeros(SMS), np.zeros(SMS)
    ends: list[list[float]] = [[] for _ in range(SMS)]

    def speed(sm: int) -> float:
        return CLOCK * min(LONE, 4 * PEAK_SHARE / max(len(ends[sm]), 1))

    for _ in range(kernel.programs):
        for sm in range(SMS):
            if waiting:
                heapq.heappush(ends[sm], waiting.pop())
    turns = [(ends[sm][0] / speed(sm), sm) for sm in range(SMS) if ends[sm]]
    heapq.heapify(turns)
    now = 0.0
    while turns:
        now, sm = heapq.heappop(turns)
        given[sm] += (now - looked[sm]) * speed(sm)
        looked[sm] = now
        given[sm] = max(given[sm], heapq.heappop(ends[sm]))
        if waiting:
            heapq.heappush(ends[sm], given[sm] + waiting.pop())
        if ends[sm]:
            heapq.heappush(turns, (now + (ends[sm][0] - given[sm]) / speed(sm), sm))
    return now


def cut(splats: np.ndarray) -> list[int]:
    """The same lists in segments, tile by tile."""
    return [min(SEGMENT, count - begin) for count in splats for begin in range(0, count, SEGMENT)]


def estimate(scene: Seen) -> dict[str, Any]:
    """Lists and milliseconds of one view."""
    listed, back, capacity = walked(scene)
    # Forward a tile walks on to the end of its list where some pixel never stops.
    deepest_first = np.sort(back)[::-1]
    return {
        "tiles": len(listed),
        "listed": float(listed.mean()),
        "walked": float(back.mean()),
        "walked_p95": float(np.quantile(back, 0.95)),
        "deepest": int(back.max()),
        "slots": capacity,
        "scattered": int(back.sum()),
        "forward_ms": 1e3 * seconds(back, FORWARD),
        "forward_sorted_ms": 1e3 * seconds(deepest_first, FORWARD),
        "backward_ms": 1e3 * seconds(back, BACKWARD),
        "backward_sorted_ms": 1e3 * seconds(deepest_first, BACKWARD),
        "backward_segments_ms": 1e3 * seconds(cut(back), BACKWARD),
    }


def zoomed(run: Path, zoom: float) -> Seen:
    """A run's first training view at so many times its size."""
    import jax
    import jax.numpy as jnp

    from gsjax import render
    from gsjax.cameras import Camera
    from gsjax.runs.result import open_result

    result = open_result(run)
    gaussians, camera = jax.tree.map(jnp.asarray, (result.gaussians, result.cameras[result.held_out.index(False)]))
    K = camera.K * jnp.array([[zoom], [zoom], [1]], jnp.float32)
    larger = Camera(camera.viewmat, K, round(zoom * camera.width), round(zoom * camera.height))
    scene = render.drawable(gaussians)
    projection, opacities = render.projected(scene, larger, "center")
    return Seen(projection, opacities, render.colors(scene, larger), larger.width, larger.height)


def main(chosen: Sequence[str] | None = None) -> None:
    """Count and print."""
    # A script beside this one has the name of the package.
    sys.path.sort(key=lambda folder: Path(folder).resolve() == Path(__file__).resolve().parent)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="*", type=Path, metavar="RUN", help="finished runs")
    parser.add_argument("--zoom", nargs="+", type=float, default=[1.0], help="sizes of their pictures")
    arguments = parser.parse_args(chosen)
    import rasterizer
    from gsjax.io.machine import versions

    rows = {HEAVY: estimate(seen(HEAVY, rasterizer.GSPLAT))}
    for run in arguments.runs:
        for zoom in arguments.zoom:
            rows[f"{run.name}, {zoom:g} times"] = estimate(zoomed(run, zoom))
    print(tables.compare(rows))
    print(tables.record({**versions(), "share_of_peak": PEAK_SHARE, "lone_warp": LONE}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
