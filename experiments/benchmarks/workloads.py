"""Seeded scenes for the benchmarks, and the clock they share."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

GOLDEN = Path(__file__).resolve().parents[3] / "shared" / "golden" / "random10k.npz"
HEAVY = "112k, 648x420, heavy tails"


class Workload(NamedTuple):
    """N seeded Gaussians in front of one camera, of about the given projected 3-sigma radius."""

    gaussians: int
    side: int  # pixels
    radius: float  # pixels


WORKLOADS = {
    "10k, 256x256, radius 6": Workload(10_000, 256, 6.0),
    "10k, 512x512, radius 6": Workload(10_000, 512, 6.0),
    "100k, 256x256, radius 3": Workload(100_000, 256, 3.0),
    "100k, 512x512, radius 3": Workload(100_000, 512, 3.0),
}


class ViewSplats(NamedTuple):
    """The splats of one camera, and its image's size in pixels."""

    projection: Any
    opacities: Any  # [N] as its pixels see them
    colors: Any  # [N, 3]
    width: int
    height: int


class Scene(NamedTuple):
    """(means, quats, scales, opacities, colors, viewmats, Ks), and the image's size in pixels."""

    arrays: tuple[Any, ...]
    width: int
    height: int


def make_scene(workload: Workload, seed: int = 0) -> Scene:
    """Evenly spread Gaussians, the same every time."""
    import numpy as np

    rng = np.random.default_rng(seed)
    count, side = workload.gaussians, workload.side
    focal = 0.9 * side
    depth = rng.uniform(2, 8, count)
    position = rng.uniform(-0.05, 1.05, (count, 2)) * side
    spread = rng.lognormal(0, 0.4, (count, 3))
    scales = workload.radius / 3 * spread * (depth / focal)[:, None]
    quats, opacities, colors = rng.normal(size=(count, 4)), rng.uniform(0.05, 1, count), rng.uniform(0, 1, (count, 3))
    return _scene(position, depth, quats, scales, opacities, colors, focal, side, side)


def heavy_tailed_scene(seed: int = 0) -> Scene:
    """Like a trained outdoor scene: clustered, sizes and opacities over decades, many hundreds deep on a tile."""
    import numpy as np

    rng = np.random.default_rng(seed)
    count, width, height, focal = 112_000, 648, 420, 480.0
    depth = rng.gamma(3, 1.5, count) + 0.5
    clustered = rng.random((count, 1)) < 0.6
    place = np.where(clustered, rng.normal([0.5, 0.62], [0.16, 0.14], (count, 2)), rng.uniform(-0.2, 1.2, (count, 2)))
    sigma = np.exp(rng.normal(np.log(1.2), 0.9, count))
    scales = (sigma * depth / focal)[:, None] * np.exp(rng.normal(0, 0.7, (count, 3)))
    opacities = 1 / (1 + np.exp(-rng.normal(-0.5, 2, count)))
    quats, colors = rng.normal(size=(count, 4)), rng.uniform(0, 1, (count, 3))
    return _scene(place * [width, height], depth, quats, scales, opacities, colors, focal, width, height)


def golden_scene(path: Path = GOLDEN) -> Scene:
    """The 10,000 Gaussians of the golden tests."""
    import jax.numpy as jnp
    import numpy as np

    golden = np.load(path)
    gaussians = [jnp.asarray(golden[name]) for name in ("means", "quats", "scales", "opacities", "colors")]
    cameras = jnp.asarray(golden["viewmat"])[None], jnp.asarray(golden["K"])[None]
    return Scene((*gaussians, *cameras), int(golden["width"]), int(golden["height"]))


def _scene(pixels, depth, quats, scales, opacities, colors, focal, width, height) -> Scene:
    import jax.numpy as jnp
    import numpy as np

    center = np.array([width, height]) / 2
    means = np.concatenate([(pixels - center) / focal * depth[:, None], depth[:, None]], -1)
    K = np.array([[focal, 0, center[0]], [0, focal, center[1]], [0, 0, 1]])
    arrays = (means, quats, scales, opacities, colors, np.eye(4)[None], K[None])
    return Scene(tuple(jnp.asarray(a, jnp.float32) for a in arrays), width, height)


def scene_named(name: str) -> Scene:
    """The scene of a row of the table."""
    if name in WORKLOADS:
        return make_scene(WORKLOADS[name])
    return heavy_tailed_scene() if name == HEAVY else golden_scene()


def workload_views(workload: str | Path, rules: Any) -> ViewSplats:
    """The splats of a row of the table by its name, or of a run by its folder."""
    import rasterizer

    if isinstance(workload, Path):
        return splats_of_run(workload)
    (means, quats, scales, opacities, colors, *cameras), width, height = scene_named(workload)
    projection = rasterizer.project(means, quats, scales, opacities, *cameras, width, height, rules=rules)
    return ViewSplats(projection, opacities, colors, width, height)


def splats_of_run(run: Path) -> ViewSplats:
    """A finished run's Gaussians from its first training camera, projected as it was trained.

    Raises:
        InputError: It is no finished run.
    """
    import jax
    import jax.numpy as jnp

    from gsjax import rendering
    from gsjax.runs.result import open_result

    result = open_result(run)
    gaussians, camera = jax.tree.map(jnp.asarray, (result.gaussians, result.cameras[result.held_out.index(False)]))
    scene = rendering.drawable(gaussians)
    projection, opacities = rendering.projected(scene, camera, "center")
    return ViewSplats(projection, opacities, rendering.colors(scene, camera), camera.width, camera.height)


class Programs(NamedTuple):
    """What a backend computes from the arrays of a scene, and how much that is."""

    projected: Callable[[Any], Any]
    binned: Callable[[Any], Any]  # projected, and listed by tiles
    image: Callable[[Any], Any]
    pairs: int  # of a tile and a Gaussian
    pixel_pairs: int  # of a pixel and a Gaussian that is listed for its tile


def programs(scene: Scene, backend: Any) -> Programs:
    """The programs of one backend."""
    import rasterizer

    arrays, width, height = scene
    _, _, info = rasterizer.rasterization(*arrays, width, height, backend=backend)
    capacity, pairs = int(info["splats"].shape[0]), int(info["offsets"][-1])
    grid = rasterizer.TileGrid(1, width, height, rasterizer.default_tile_size(backend))

    def projected(arrays: Any) -> Any:
        return rasterizer.project(*arrays[:4], *arrays[5:], width, height)

    def binned(arrays: Any) -> Any:
        return rasterizer.bin_splats(projected(arrays), arrays[3], grid, capacity, rasterizer.GSPLAT, backend=backend)

    def image(arrays: Any) -> Any:
        return rasterizer.rasterization(*arrays, width, height, capacity=capacity, backend=backend)[0]

    return Programs(projected, binned, image, pairs, pairs * grid.tile_size**2)


def milliseconds(function: Callable[..., Any], *arguments: Any, repeats: int = 15) -> tuple[float, float]:
    """(first call, median of the later ones), milliseconds; the first compiles."""
    import jax

    spans = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        spans.append(1e3 * (time.perf_counter() - start))
    return spans[0], sorted(spans[1:])[repeats // 2]
