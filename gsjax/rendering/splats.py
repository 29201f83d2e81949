"""The splats of one view: Gaussians of any kind, projected and binned once for as many passes as are needed."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import singledispatch
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

import rasterizer
from gsjax.gaussians import Gaussians, PixelFilter, opacities, scales
from gsjax.numerics import safe_normalize
from gsjax.scene.cameras import Camera
from rasterizer import DepthMode

PIXEL_FILTERS: dict[PixelFilter, dict[str, Any]] = {
    "classic": {"eps2d": 0.3},
    "mip": {"eps2d": 0.1, "rasterize_mode": "antialiased"},
}
"""Blur of a projected Gaussian, pixels squared: the one of 3DGS, which makes small splats larger than they are, and the
one of Mip-Splatting (and of Brush's mip mode), which dims them in return."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Drawable:
    """What a renderer needs of Gaussians of any kind. The shape is `quats` and `scales`, or else `covars`."""

    means: Array  # [N, 3] world
    opacities: Array  # [N]
    sh_dc: Array  # [N, 1, 3] coefficients of degree 0
    sh_rest: Array  # [N, (L+1)^2 - 1, 3] of degrees 1..L
    quats: Array | None = None  # [N, 4] (w, x, y, z)
    scales: Array | None = None  # [N, 3] standard deviations, scene units
    covars: Array | None = None  # [N, 3, 3] world, scene units squared
    pixel_filter: PixelFilter = field(default="classic", metadata={"static": True})


@singledispatch
def drawable(gaussians: Any) -> Drawable:
    """The `Drawable` of a kind of Gaussians; a kind of its own registers how: `drawable.register`."""
    raise TypeError(f"no way to draw a {type(gaussians).__name__} is registered")


@drawable.register
def _(gaussians: Drawable) -> Drawable:
    return gaussians


@drawable.register
def _(gaussians: Gaussians) -> Drawable:
    return Drawable(
        means=gaussians.means,
        opacities=opacities(gaussians),
        sh_dc=gaussians.sh_dc,
        sh_rest=gaussians.sh_rest,
        quats=gaussians.quats,
        scales=scales(gaussians),
        pixel_filter=gaussians.pixel_filter,
    )


def in_one_dtype(gaussians: Any, camera: Camera, backend: rasterizer.Backend) -> tuple[Drawable, Camera]:
    """What is drawn and the camera, in float32; in float64 where the Gaussians are and the backend is "reference".

    Gradients have the dtypes of the arrays that were passed.
    """
    is_half = (jnp.bfloat16, jnp.float16)
    gaussians = jax.tree.map(lambda x: x.astype(jnp.float32) if jnp.result_type(x) in is_half else x, gaussians)
    scene = drawable(gaussians)
    dtype = scene.means.dtype if backend == "reference" else jnp.float32

    def cast(x: Array) -> Array:
        return x if x.dtype == dtype else jnp.asarray(x, dtype)

    return jax.tree.map(cast, (scene, camera))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Splats:
    """A scene's splats in one view, binned: what every pass over that view shares."""

    projection: rasterizer.Projection  # one camera
    opacities: Array  # [N] as the pixels see them: dimmed by the filter where it dims
    pairs: rasterizer.TilePairs | None  # None: the backend lists splats by itself, in every pass
    grid: rasterizer.TileGrid = field(metadata={"static": True})
    backend: rasterizer.Backend = field(default="auto", metadata={"static": True})  # that listed and blends them


def splat(
    gaussians: Any,
    camera: Camera,
    capacity: int | None = None,
    means2d_probe: Array | None = None,
    depth_mode: DepthMode = "center",
    backend: rasterizer.Backend = "auto",
) -> Splats:
    """Project and bin.

    Args:
        gaussians: The scene, of any kind that `drawable` knows.
        camera: The view.
        capacity: Length of the (tile, splat) buffer. Static. `pairs.overflowed` is true where it was too short. None:
            a CPU's native loops and "reference" need no buffer, the other backends count first.
        means2d_probe: `[N, 2]` zeros added to the projected means: the gradient to it is the one to the 2D means.
        depth_mode: "plane" gives the splats slopes, see `rasterizer.project`. Static.
        backend: What lists the splats, and blends them in every pass, see `rasterizer.rasterization`. Static.

    Returns:
        `Splats` of this view.

    Raises:
        ValueError: No capacity is given inside a compiled program, where a backend cannot count.
    """
    scene, camera = in_one_dtype(gaussians, camera, backend)
    projection, opacities = projected(scene, camera, depth_mode, backend)
    if means2d_probe is not None:
        projection = projection._replace(means2d=projection.means2d + means2d_probe[None])
    grid = tile_grid(camera, backend)
    if capacity is None and rasterizer.lists_by_itself(backend):
        return Splats(projection, opacities, None, grid, backend)
    capacity = rasterizer.count_capacity(projection, grid) if capacity is None else capacity
    pairs = rasterizer.bin_splats(projection, opacities, grid, capacity, rasterizer.GSPLAT, backend=backend)
    return Splats(projection, opacities, pairs, grid, backend)


def needed_capacity(gaussians: Any, camera: Camera, backend: rasterizer.Backend = "auto") -> Array:
    """`[]` int32 length of the pair buffer that this view needs."""
    scene, camera = in_one_dtype(gaussians, camera, backend)
    return rasterizer.count_pairs(projected(scene, camera, "center", backend)[0], tile_grid(camera, backend))


def largest_need(gaussians: Any, cameras: Iterable[Camera]) -> int:
    """Length of the pair buffer that serves every one of the views; one program counts in all that are of one size."""
    return max(map(int, [_needed(gaussians, camera) for camera in cameras]))  # All are begun before one is waited for.


_needed = jax.jit(needed_capacity, static_argnames="backend")


def projected(
    scene: Drawable, camera: Camera, depth_mode: DepthMode, backend: rasterizer.Backend = "auto"
) -> tuple[rasterizer.Projection, Array]:
    """The splats of one view, and `[N]` their opacities as its pixels see them."""
    projection = rasterizer.project(
        scene.means,
        scene.quats,
        scene.scales,
        scene.opacities,
        camera.viewmat[None],
        camera.K[None],
        camera.width,
        camera.height,
        covars=scene.covars,
        depth_mode=depth_mode,
        backend=backend,
        **PIXEL_FILTERS[scene.pixel_filter],
    )
    opacities = scene.opacities
    if projection.compensations is not None:
        opacities = opacities * projection.compensations[0]
    return projection, opacities


def tile_grid(camera: Camera, backend: rasterizer.Backend = "auto") -> rasterizer.TileGrid:
    """The tiles of a view."""
    return rasterizer.TileGrid(1, camera.width, camera.height, rasterizer.default_tile_size(backend))


def features(
    splats: Splats, values: Array, front: rasterizer.Front | None = None, probes: Array | None = None
) -> tuple[Array, Array]:
    """`[H, W, D + K]` per-Gaussian `values` `[N, D]` composited on zero, then zeros of `[N, K]` probes; and alphas."""
    values = jnp.where(splats.projection.visible[0, :, None], values, 0)
    to_blend = splats.projection, splats.opacities, values[None], splats.pairs, splats.grid
    zeros = None if probes is None else probes[None]
    image, left, _ = rasterizer.blend(*to_blend, backend=splats.backend, front=front, probes=zeros)
    return image[0], 1 - left[0, ..., 0]


def facing_axes(scene: Drawable, camera: Camera, projection: rasterizer.Projection) -> Array:
    """`[N, 3]` unit directions of the smallest axes in the camera's frame, facing it: the normals of discs.

    Zero where a Gaussian does not show. Differentiable to `quats` and the camera's matrix, not to `means`, which decide
    the side, nor to `scales`, which decide the axis.
    """
    shapes = scene.means, scene.quats, scene.scales
    axes = rasterizer.camera_normals(*shapes, camera.viewmat[None], jax.lax.stop_gradient(projection.visible))[0]
    return safe_normalize(axes)


def owners(splats: Splats) -> Array:
    """`[H, W]` int32: the Gaussian in which the light of each pixel falls to one half, or the last one that shows.

    -1 where none does. Not differentiable.
    """
    nothing = jnp.zeros((1, len(splats.opacities), 1), splats.opacities.dtype)
    to_blend = splats.projection, splats.opacities, nothing, splats.pairs, splats.grid
    _, _, median = rasterizer.blend(*to_blend, backend=splats.backend, with_median=True)
    assert median is not None  # as asked for
    return median[0]
