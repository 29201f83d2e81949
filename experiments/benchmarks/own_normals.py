"""How far own normals are smoothed: errors of depth with bumps, at the smallest windows and at the chosen ones.

Bumps are noise correlated over 1, 2 and 3 pixels at 256 (the plane) or 160 pixels (the scene), and grow with the
picture as those of splats do.
"""

import argparse
import sys
import time
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from gsjax import tables
from gsjax.cli import guarded
from gsjax.io.machine import machine, versions

PLANES = (128, 256, 512, 1024)
SCENES = (160, 320, 640)
TIMED = (1600, 1060)


def bumps(shape: tuple[int, int], scale: float) -> np.ndarray:
    """`[H, W]` noise of unit variance."""
    rng = np.random.default_rng(0)
    fields = [gaussian_filter(rng.standard_normal(shape), scale * size) for size in (1.0, 2.0, 3.0)]
    return sum((f / f.std() for f in fields), np.zeros(shape)) / np.sqrt(3)


def plane(size: int) -> dict[str, Any]:
    """A tilted plane of 0.4 % noise."""
    import jax.numpy as jnp

    from gsjax.cameras import Camera, pixel_rays

    K = jnp.asarray([[1.2 * size, 0, size / 2], [0, 1.2 * size, size / 2], [0, 0, 1]], jnp.float32)
    camera = Camera(jnp.eye(4, dtype=jnp.float32), K, size, size)
    normal = np.array([0.4, -0.3, -1]) / np.linalg.norm([0.4, -0.3, -1])
    depth = -2.0 / (np.asarray(pixel_rays(camera), np.float64) @ normal) * (1 + 0.004 * bumps((size, size), size / 256))
    return errors(depth, camera, np.broadcast_to(normal, (size, size, 3)), np.zeros((size, size), bool))


def scene(size: int, amplitude: float) -> dict[str, Any]:
    """A view of the built-in scene."""
    from gsjax.analytic import solids

    camera = solids.cameras(8, (size, size))[2]
    trace = solids.trace(camera, samples=1)
    depth = np.asarray(trace.depth, np.float64) * (1 + amplitude * bumps((size, size), size / 160))
    return errors(depth, camera, np.asarray(trace.normals), np.asarray(trace.labels) < solids.GROUND_LABEL)


def errors(depth: np.ndarray, camera: Any, truth: np.ndarray, objects: np.ndarray) -> dict[str, Any]:
    """Mean degrees over all pixels that have a normal, and over the objects', by how it was estimated."""
    import jax.numpy as jnp

    from gsjax.normals.from_depth import chosen_reduction, depth_normals, smoothed_depth_normals

    view = jnp.asarray(depth, jnp.float32), jnp.asarray(depth > 0, jnp.float32), camera
    reduction = chosen_reduction([view])
    maps = {
        "raw": depth_normals(view[0], camera),
        "smallest": smoothed_depth_normals(*view),
        "chosen": smoothed_depth_normals(*view, reduction=reduction),
    }
    found: dict[str, Any] = {"reduction": reduction}
    for name, normals in maps.items():
        cosines = np.clip(np.sum(np.asarray(normals) * truth, axis=-1), -1, 1)
        known = np.any(np.asarray(normals), axis=-1) & (depth > 0)
        for where, mask in (("", known), ("_objects", known & objects)):
            if mask.any():
                found[name + where] = float(np.degrees(np.arccos(cosines[mask])).mean())
    return found


def cost(reduction: int, rounds: int = 3) -> dict[str, Any]:
    """Seconds a view, seconds to compile, and bytes a pixel of temporaries."""
    import jax
    import jax.numpy as jnp

    from gsjax.cameras import Camera
    from gsjax.normals.from_depth import smoothed_depth_normals

    width, height = TIMED
    K = jnp.asarray([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]], jnp.float32)
    view = jnp.ones((height, width)), jnp.ones((height, width)), Camera(jnp.eye(4, dtype=jnp.float32), K, width, height)
    started = time.perf_counter()
    program = smoothed_depth_normals.lower(*view, reduction=reduction).compile()
    figures: dict[str, Any] = {"compile_s": time.perf_counter() - started}
    seconds = []
    for _ in range(rounds):
        started = time.perf_counter()
        jax.block_until_ready(program(*view))
        seconds.append(time.perf_counter() - started)
    memory = program.memory_analysis()
    temporaries = None if memory is None else memory.temp_size_in_bytes / (width * height)
    return {"seconds": min(seconds), **figures, "bytes_a_pixel": temporaries}


def main() -> None:
    """Measure and print the tables, with machine and versions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--planes", type=int, nargs="*", default=PLANES, help="sizes, pixels")
    parser.add_argument("--scenes", type=int, nargs="*", default=SCENES, help="sizes, pixels")
    parser.add_argument("--reductions", type=int, nargs="*", default=(1, 2, 4, 8, 16), help="to be timed")
    arguments = parser.parse_args()
    rows = {f"plane, {size} pixels": plane(size) for size in arguments.planes}
    for size in arguments.scenes:
        for amplitude in (0.0, 0.003, 0.01):
            rows[f"scene, {size} pixels, {100 * amplitude:g} %"] = scene(size, amplitude)
    print(tables.compare(rows))
    print(tables.compare({f"reduction {r}": cost(r) for r in arguments.reductions}))
    print(tables.record({**machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(guarded(main))
