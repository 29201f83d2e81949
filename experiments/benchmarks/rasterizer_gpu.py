"""Is the rasterizer right on this GPU, and how long does it take? Compared with gsplat where that is installed.

    python experiments/benchmarks/rasterizer_gpu.py [--counts 100k 1M] [--sizes 1080p 4K] [--run RUN]

First its images and gradients are compared with those of the reference; where they differ it ends there. Then come the
parts of a pass over seeded Gaussians; and with RUN, a finished run, a whole training step of every phase of the preset
`fast` from its Gaussians, and gsplat's passes over the same view.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from workloads import Scene, Workload, make_scene, milliseconds, programs

from gsjax.cli import run_guarded
from gsjax.errors import InputError
from gsjax.report import tables

COUNTS = {"100k": 100_000, "1M": 1_000_000, "3M": 3_000_000}
SIZES = {"1080p": (1920, 1080), "4K": (3840, 2160)}
RADIUS = 6.0  # Mean projected 3-sigma radius at 1080p, pixels.
IMAGE_BOUND = 5e-3  # A splat of which rounding decides whether it passes the cut moves a pixel by 1/255.
GRADIENT_BOUND = 1e-3  # Relative; roundings alone make 1e-5.


def workload(count: int, size: tuple[int, int]) -> Scene:
    """Evenly spread Gaussians over a wide image: a square scene of its width, of which the middle is drawn."""
    width, height = size
    scene = make_scene(Workload(count, width, RADIUS * width / 1920))
    *gaussians, viewmats, Ks = scene.arrays
    return Scene((*gaussians, viewmats, Ks.at[0, 1, 2].set(height / 2)), width, height)


def small_scenes() -> dict[str, Scene]:
    """What the reference can do: ordinary Gaussians, and faint ones, so deep that every pixel walks whole lists."""
    plain, (means, quats, scales, opacities, *rest), width, height = (
        make_scene(Workload(2000, 128, 8.0)),
        *make_scene(Workload(6000, 64, 10.0)),
    )
    return {"plain": plain, "deep": Scene((means, quats, scales, 0.02 * opacities, *rest), width, height)}


def errors_against_reference(scene: Scene, backend: str) -> dict[str, float]:
    """Largest error of an image and relative error of every gradient."""
    import jax
    import jax.numpy as jnp

    import rasterizer

    arrays, width, height = scene

    def loss(arrays, backend):
        image, alphas, _ = rasterizer.rasterization(*arrays, width, height, capacity=1 << 17, backend=backend)
        return jnp.sum(image**2) + jnp.sum(alphas), image

    run = jax.jit(jax.value_and_grad(loss, has_aux=True), static_argnums=1)
    ((_, image), gradient), ((_, expected_image), expected) = run(arrays, backend), run(arrays, "reference")
    names = ("means", "quats", "scales", "opacities", "colors")
    relative = {
        n: jnp.linalg.norm(g - e) / jnp.linalg.norm(e)
        for n, g, e in zip(names, gradient[:5], expected[:5], strict=True)
    }
    return {"image": float(jnp.abs(image - expected_image).max()), **{n: float(r) for n, r in relative.items()}}


def require_right(errors: dict[str, dict[str, float]]) -> None:
    """Raises InputError where an error is larger than rounding: its time has no meaning."""
    wrong = [
        f"{scene}, {name}: {error:.2g}"
        for scene, row in errors.items()
        for name, error in row.items()
        if not error < (IMAGE_BOUND if name == "image" else GRADIENT_BOUND)
    ]
    if wrong:
        raise InputError(f"the kernels differ from the reference ({'; '.join(wrong)}): nothing is timed")


def measure(scene: Scene, backend: str) -> dict[str, float]:
    """Milliseconds and memory of our rasterizer."""
    import jax
    import jax.numpy as jnp

    arrays, (projected, listed, image, pairs, pixel_pairs) = scene.arrays, programs(scene, backend)
    gradient = jax.jit(jax.grad(lambda a: jnp.sum(image((*a, *arrays[5:])) ** 2)))
    _, forward = milliseconds(jax.jit(image), arrays)
    _, both = milliseconds(gradient, arrays[:5])
    temporary = gradient.lower(arrays[:5]).compile().memory_analysis().temp_size_in_bytes
    return {
        "pairs": pairs,
        "projection_ms": milliseconds(jax.jit(projected), arrays)[1],
        "with_lists_ms": milliseconds(jax.jit(listed), arrays)[1],
        "forward_ms": forward,
        "forward_backward_ms": both,
        "forward_backward_ns": 1e6 * both / pixel_pairs,
        "workspace_mib": temporary / 2**20,
    }


def gsplat_of(scene: Scene) -> Callable[[], dict[str, float]] | None:
    """The same measurement of gsplat's CUDA kernels, or None where they are not installed."""
    try:
        import gsplat
        import torch
    except ImportError:
        return None
    if not torch.cuda.is_available():
        return None
    import numpy as np

    arrays, width, height = scene
    tensors = [torch.tensor(np.asarray(a), device="cuda") for a in arrays]

    def image() -> Any:
        return gsplat.rasterization(*tensors, width, height, packed=False)[0]

    def forward():
        with torch.no_grad():
            image()
        torch.cuda.synchronize()

    def both():
        (image() ** 2).sum().backward()
        torch.cuda.synchronize()

    def run() -> dict[str, float]:
        for tensor in tensors[:5]:
            tensor.requires_grad_(True)
        torch.cuda.reset_peak_memory_stats()
        baseline = torch.cuda.memory_allocated()
        timed = {"forward_ms": milliseconds(forward)[1], "forward_backward_ms": milliseconds(both)[1]}
        return {**timed, "workspace_mib": (torch.cuda.max_memory_allocated() - baseline) / 2**20}

    return run


def steps_of(run: Path) -> dict[str, dict[str, float]]:
    """Milliseconds of a whole training step of every phase from a run's Gaussians, and of gsplat over one view."""
    import jax
    import jax.numpy as jnp
    from step_profile import steppers

    from gsjax import gaussians, rendering
    from gsjax.planning.sizes import training_extent
    from gsjax.presets import preset
    from gsjax.runs.result import open_result, scene_of_run

    result, scene = open_result(run), scene_of_run(run)
    steps = steppers(preset("fast"), result.gaussians, scene.train_frames, training_extent(scene))
    rows = {f"a step, {phase}": {"step_ms": milliseconds(once)[1]} for phase, once in steps.items()}
    cloud, camera = jax.tree.map(jnp.asarray, (result.gaussians, result.cameras[result.held_out.index(False)]))
    colors = rendering.colors(rendering.drawable(cloud), camera)
    shape = cloud.means, cloud.quats, gaussians.scales(cloud), gaussians.opacities(cloud), colors
    peer = gsplat_of(Scene((*shape, camera.viewmat[None], camera.K[None]), camera.width, camera.height))
    return rows if peer is None else {**rows, "gsplat, one view": peer()}


def main(argv: Sequence[str] | None = None) -> None:
    """Compare, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", choices=("pallas", "xla"), default="pallas", help="engine to time")
    parser.add_argument("--counts", nargs="+", choices=COUNTS, default=list(COUNTS), help="numbers of Gaussians")
    parser.add_argument("--sizes", nargs="+", choices=SIZES, default=list(SIZES), help="image sizes")
    parser.add_argument("--run", type=Path, metavar="RUN", help="a finished run, whose training steps are timed too")
    arguments = parser.parse_args(argv)
    import jax

    from gsjax.io.machine import machine, versions

    if jax.default_backend() != "gpu":
        raise InputError(f"no GPU: jax runs on {jax.default_backend()!r} here")
    errors = {name: errors_against_reference(scene, arguments.backend) for name, scene in small_scenes().items()}
    print(tables.compare(errors))
    require_right(errors)
    rows: dict[str, dict[str, float]] = {}
    for count in arguments.counts:
        for size in arguments.sizes:
            scene = workload(COUNTS[count], SIZES[size])
            rows[f"{count}, {size}"] = measure(scene, arguments.backend)
            peer = gsplat_of(scene)
            if peer is not None:
                rows[f"{count}, {size}, gsplat"] = peer()
    print(tables.compare(rows))
    if arguments.run is not None:
        print(tables.compare(steps_of(arguments.run)))
    print(tables.record({**machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
