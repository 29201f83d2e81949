"""Times the tile rasterizer on seeded workloads, stage by stage, and prints a table with the machine beside it."""

import argparse
import resource
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from gsjax import tables
from gsjax.cli import guarded

REPEATS = 9


class Workload(NamedTuple):
    """N seeded Gaussians in front of one camera, of about the given projected 3-sigma radius."""

    gaussians: int
    side: int  # pixels
    radius: float  # pixels


WORKLOADS = {
    "10k, 256 px, radius 6": Workload(10_000, 256, 6.0),
    "10k, 512 px, radius 6": Workload(10_000, 512, 6.0),
    "100k, 256 px, radius 3": Workload(100_000, 256, 3.0),
    "100k, 512 px, radius 3": Workload(100_000, 512, 3.0),
}


def make_scene(workload: Workload) -> tuple[Any, ...]:
    """(means, quats, scales, opacities, colors, viewmats, Ks) of a workload, the same every time."""
    import jax.numpy as jnp
    import numpy as np

    rng = np.random.default_rng(0)
    count, side = workload.gaussians, workload.side
    focal = 0.9 * side
    depth = rng.uniform(2, 8, count)
    position = rng.uniform(-0.05, 1.05, (count, 2)) * side
    means = np.concatenate([(position - side / 2) / focal * depth[:, None], depth[:, None]], -1)
    spread = rng.lognormal(0, 0.4, (count, 3))
    scales = workload.radius / 3 * spread * (depth / focal)[:, None]
    quats, opacities, colors = rng.normal(size=(count, 4)), rng.uniform(0.05, 1, count), rng.uniform(0, 1, (count, 3))
    K = np.array([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1]])
    arrays = (means, quats, scales, opacities, colors, np.eye(4)[None], K[None])
    return tuple(jnp.asarray(a, jnp.float32) for a in arrays)


def milliseconds(function: Callable[..., Any], *arguments: Any) -> tuple[float, float]:
    """(first call, median of the later ones), milliseconds; the first compiles."""
    import jax

    spans = []
    for _ in range(REPEATS + 1):
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        spans.append(1e3 * (time.perf_counter() - start))
    return spans[0], sorted(spans[1:])[REPEATS // 2]


def measure(workload: Workload) -> dict[str, float]:
    """Figures of one workload."""
    import jax
    import jax.numpy as jnp

    import rasterizer

    jax.config.update("jax_enable_compilation_cache", False)  # Or compile times would be those of reading a file.
    scene = make_scene(workload)
    side = workload.side
    _, _, info = rasterizer.rasterization(*scene, side, side)
    capacity = int(info["splats"].shape[0])
    pairs = int(info["offsets"][-1])
    grid = rasterizer.TileGrid(1, side, side, rasterizer.default_tile_size())

    def projected(*arrays):
        return rasterizer.project(*arrays[:4], *arrays[5:], side, side)

    def binned(*arrays):
        return rasterizer.bin_splats(projected(*arrays), arrays[3], grid, capacity, rasterizer.GSPLAT)

    def image(*arrays):
        return rasterizer.rasterization(*arrays, side, side, capacity=capacity)[0]

    def loss(arrays):
        return jnp.sum(image(*arrays) ** 2)

    _, projection_ms = milliseconds(jax.jit(projected), *scene)
    _, binning_ms = milliseconds(jax.jit(binned), *scene)
    _, forward_ms = milliseconds(jax.jit(image), *scene)
    first_ms, both_ms = milliseconds(jax.jit(jax.grad(loss)), scene)
    pixel_pairs = pairs * rasterizer.default_tile_size() ** 2
    return {
        "pairs": pairs,
        "projection_ms": projection_ms,
        "projection_and_binning_ms": binning_ms,
        "forward_ms": forward_ms,
        "forward_backward_ms": both_ms,
        "forward_ns_per_pixel_pair": 1e6 * (forward_ms - binning_ms) / pixel_pairs,
        "backward_ns_per_pixel_pair": 1e6 * (both_ms - forward_ms) / pixel_pairs,
        "compile_s": (first_ms - both_ms) / 1e3,
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def main(chosen: Sequence[str] | None = None) -> None:
    """Measure and print."""
    # Run as a script, this file would be found before the package of its name.
    sys.path = [folder for folder in sys.path if Path(folder).resolve() != Path(__file__).resolve().parent]
    from gsjax.io.machine import machine, versions

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=WORKLOADS, help="one workload")
    arguments = parser.parse_args(chosen)
    names = [arguments.only] if arguments.only else list(WORKLOADS)
    print(tables.compare({name: measure(WORKLOADS[name]) for name in names}))
    print(tables.record({**machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(guarded(main))
