"""Gaussians and a camera to images: one projection and one binning, then as many channels as are asked for."""

from dataclasses import dataclass, field
from functools import singledispatch
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

import rasterizer
from gsjax import cameras
from gsjax.cameras import Camera
from gsjax.gaussians import Gaussians, PixelFilter, opacities, scales, sh_coefficients
from gsjax.numerics import safe_divide
from rasterizer import DepthMode

DepthReading = Literal["center", "plane", "front", "discs"]
"""What a pixel's depth is: the mean of its splats', each as `rasterizer.DepthMode` has it; or the mean of the planes of
those in front, see `IN_FRONT`."""

IN_FRONT: dict[str | None, rasterizer.Front] = {
    "front": rasterizer.Front(channels=4, stop_after=0.2),
    "discs": rasterizer.Front(channels=4, stop_after=0.4),
}
"""Planes and what they cover, down to some of the light: what shines through the first layers from far behind is a few
hundredths of the light, but not of its depth. More shines through discs on a mesh, of its far side."""

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
    sh: Array  # [N, (L+1)^2, 3]
    quats: Array | None = None  # [N, 4] (w, x, y, z)
    scales: Array | None = None  # [N, 3] standard deviations, scene units
    covars: Array | None = None  # [N, 3, 3] world, scene units squared
    pixel_filter: PixelFilter = field(default="classic", metadata={"static": True})


@singledispatch
def drawable(gaussians: Any) -> Drawable:
    """The `Drawable` of a kind of Gaussians; a kind of its own registers how: `drawable.register`."""
    raise TypeError(f"no way to draw a {type(gaussians).__name__} is registered")


@drawable.register
def _(gaussians: Gaussians) -> Drawable:
    return Drawable(
        means=gaussians.means,
        opacities=opacities(gaussians),
        sh=sh_coefficients(gaussians),
        quats=gaussians.quats,
        scales=scales(gaussians),
        pixel_filter=gaussians.pixel_filter,
    )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Splats:
    """A scene's splats in one view, binned: what every pass over that view shares."""

    projection: rasterizer.Projection  # one camera
    opacities: Array  # [N] as the pixels see them: dimmed by the filter where it dims
    pairs: rasterizer.TilePairs
    grid: rasterizer.TileGrid = field(metadata={"static": True})
    backend: rasterizer.Backend = field(default="auto", metadata={"static": True})  # that listed and blends them


class Neighbor(NamedTuple):
    """What another camera sees of the same scene, as far as a term compares it with a view."""

    camera: Camera
    depth: Array  # [H, W] as in `View`
    pairs: rasterizer.TilePairs
    image: Array | None = None  # [H, W, 3] its photo, 0..1, over the background
    valid: Array | None = None  # [H, W] bool, of the photo


class View(NamedTuple):
    """What one view shows. `depth` is None where it was not asked for."""

    colors: Array  # [H, W, 3] over the background, not clamped
    alphas: Array  # [H, W] coverage
    depth: Array | None  # [H, W] camera z, of all splats or those in front; 0 where alpha is under `MIN_COVERAGE`
    splats: Splats
    extra: Array | None = None  # [H, W, D] what `extra` composites to, on zero
    neighbor: Neighbor | None = None  # only in a step whose loss has a term between two views


MIN_COVERAGE = 0.5  # A pixel covered less has no surface whose depth would mean anything (method: A10, A11).


def splat(
    gaussians: Any,
    camera: Camera,
    capacity: int,
    means2d_probe: Array | None = None,
    depth_mode: DepthMode = "center",
    backend: rasterizer.Backend = "auto",
) -> Splats:
    """Project and bin.

    Args:
        gaussians: The scene, of any kind that `drawable` knows.
        camera: The view.
        capacity: Length of the (tile, splat) buffer. Static. `pairs.overflowed` says that it was too short.
        means2d_probe: `[N, 2]` zeros added to the projected means: the gradient to it is the one to the 2D means.
        depth_mode: "plane" gives the splats slopes, see `rasterizer.project`. Static.
        backend: What lists the splats, and blends them in every pass, see `rasterizer.rasterization`. Static.

    Returns:
        `Splats` of this view.
    """
    return _splat(drawable(gaussians), camera, capacity, means2d_probe, depth_mode, backend)


def needed_capacity(gaussians: Any, camera: Camera, backend: rasterizer.Backend = "auto") -> Array:
    """`[]` int32 length of the pair buffer that this view needs."""
    return rasterizer.count_pairs(_project(drawable(gaussians), camera), tile_grid(camera, backend))


def _splat(
    scene: Drawable,
    camera: Camera,
    capacity: int,
    means2d_probe: Array | None,
    depth_mode: DepthMode,
    backend: rasterizer.Backend,
) -> Splats:
    projection, opacities = projected(scene, camera, depth_mode)
    if means2d_probe is not None:
        projection = projection._replace(means2d=projection.means2d + means2d_probe[None])
    return binned(projection, opacities, camera, capacity, backend)


def projected(scene: Drawable, camera: Camera, depth_mode: DepthMode) -> tuple[rasterizer.Projection, Array]:
    """The splats of one view, and `[N]` their opacities as its pixels see them."""
    projection = _project(scene, camera, depth_mode)
    opacities = scene.opacities
    if projection.compensations is not None:
        opacities = opacities * projection.compensations[0]
    return projection, opacities


def binned(
    projection: rasterizer.Projection,
    opacities: Array,
    camera: Camera,
    capacity: int,
    backend: rasterizer.Backend = "auto",
) -> Splats:
    """The splats of one view (see `projected`) with their lists; `capacity` and `backend` as in `splat`."""
    grid = tile_grid(camera, backend)
    pairs = rasterizer.bin_splats(projection, opacities, grid, capacity, rasterizer.GSPLAT, backend=backend)
    return Splats(projection, opacities, pairs, grid, backend)


def _project(scene: Drawable, camera: Camera, depth_mode: DepthMode = "center") -> rasterizer.Projection:
    return rasterizer.project(
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
        **PIXEL_FILTERS[scene.pixel_filter],
    )


def tile_grid(camera: Camera, backend: rasterizer.Backend = "auto") -> rasterizer.TileGrid:
    """The tiles of a view."""
    return rasterizer.TileGrid(1, camera.width, camera.height, rasterizer.default_tile_size(backend))


def features(splats: Splats, values: Array, front: rasterizer.Front | None = None) -> tuple[Array, Array]:
    """`[H, W, D]` per-Gaussian `values` `[N, D]` composited on zero, and `[H, W]` alphas."""
    values = jnp.where(splats.projection.visible[0, :, None], values, 0)
    to_blend = splats.projection, splats.opacities, values[None], splats.pairs, splats.grid
    image, left, _ = rasterizer.blend(*to_blend, backend=splats.backend, front=front)
    return image[0], 1 - left[0, ..., 0]


def owners(splats: Splats) -> Array:
    """`[H, W]` int32: the Gaussian in which the light of each pixel falls to one half, or the last one that shows.

    -1 where none does. Not differentiable.
    """
    nothing = jnp.zeros((1, len(splats.opacities), 1), splats.opacities.dtype)
    to_blend = splats.projection, splats.opacities, nothing, splats.pairs, splats.grid
    _, _, median = rasterizer.blend(*to_blend, backend=splats.backend, with_median=True)
    assert median is not None  # as asked for
    return median[0]


def colors(scene: Drawable, camera: Camera, active_degree: Array | int | None = None) -> Array:
    """`[N, 3]` colour of every Gaussian seen from the camera, at least 0 (3DGS: max(0, SH + 0.5)).

    `active_degree`, one for all or `[N]`, may be traced: bands above it are multiplied by zero, so a ramp never
    recompiles.
    """
    coefficients = scene.sh
    if active_degree is not None:
        band = jnp.floor(jnp.sqrt(jnp.arange(coefficients.shape[1], dtype=jnp.float32)))
        shown = band[None] <= jnp.asarray(active_degree, jnp.float32).reshape(-1, 1)
        coefficients = coefficients * shown.astype(coefficients.dtype)[..., None]
    degree = round(coefficients.shape[1] ** 0.5) - 1
    directions = scene.means - cameras.center(camera)[None]
    return jnp.maximum(rasterizer.spherical_harmonics(degree, directions, coefficients) + 0.5, 0)


def view(
    gaussians: Any,
    camera: Camera,
    *,
    capacity: int,
    background: Array,
    active_degree: Array | int | None = None,
    with_depth: bool = False,
    depth_mode: DepthReading = "plane",
    means2d_probe: Array | None = None,
    extra: Array | None = None,
    backend: rasterizer.Backend = "auto",
) -> View:
    """Render one view. Differentiable to the Gaussians, the camera matrices and the background.

    Args:
        gaussians: The scene, of any kind that `drawable` knows.
        camera: The view.
        capacity: See `splat`.
        background: `[3]` colour under the image, or `[H, W, 3]`.
        active_degree: Highest SH degree used, one for all or `[N]`; may be traced. None: all.
        with_depth: Whether depth is composited too. Static; not in the program otherwise.
        depth_mode: What a splat's depth is: "plane" where the Gaussian is densest along each pixel's ray, "center" that
            of its mean; depth is the mean over the splats. "front": the mean of the planes of those in front, see
            `IN_FRONT`; "discs": the same of discs on a mesh. Static.
        means2d_probe: See `splat`.
        extra: `[N, D]` further channels, composited on zero.
        backend: As in `rasterizer.rasterization`; "reference" has forward mode and derivatives of any order. Static.

    Returns:
        `View`.

    Raises:
        TypeError: In forward mode, or differentiated a second time, unless the backend is "reference".
    """
    scene, reading = drawable(gaussians), depth_mode if with_depth else None
    splats = _splat(scene, camera, capacity, means2d_probe, of_each(reading), backend)
    return view_splats(splats, colors(scene, camera, active_degree), background, reading=reading, extra=extra)


def of_each(reading: DepthReading | None) -> DepthMode:
    """What depth splats are projected with to be read so; None: depth is not read."""
    return "center" if reading in (None, "center") else "plane"


def view_splats(
    splats: Splats, colors: Array, background: Array, *, reading: DepthReading | None = None, extra: Array | None = None
) -> View:
    """What splats of `[N, 3]` colours show, and their depth if it is read; the rest as in `view`."""
    channels, depth = colors, None
    if extra is not None:
        channels = jnp.concatenate([channels, extra], -1)
    before_depth = channels.shape[1]
    if reading in ("center", "plane"):
        channels = jnp.concatenate([channels, _depths(splats)], -1)
    elif reading in IN_FRONT:
        channels = jnp.concatenate([channels, _in_front(splats)], -1)
    image, alphas = features(splats, channels, IN_FRONT.get(reading))
    if reading in ("center", "plane"):
        depth = _mean_depth(image[..., before_depth:], alphas)
    elif reading in IN_FRONT:
        depth = _mean_depth(image[..., before_depth:-1], image[..., -1])
    under = background if background.ndim == 3 else background[None, None]
    over = image[..., :3] + (1 - alphas)[..., None] * under
    return View(over, alphas, depth, splats, None if extra is None else image[..., 3:before_depth])


def front_depth(splats: Splats, front: rasterizer.Front) -> Array:
    """`[H, W]` mean depth of the splats in front, see `IN_FRONT`; 0 where next to nothing is. A pass of its own."""
    image, _ = features(splats, _in_front(splats), front)
    return _mean_depth(image[..., :-1], image[..., -1])


def _in_front(splats: Splats) -> Array:
    depths = _depths(splats)
    return jnp.concatenate([depths, jnp.ones_like(depths[:, :1])], -1)


def _depths(splats: Splats) -> Array:
    return rasterizer.depth_channels(splats.projection, splats.grid.width, splats.grid.height)[0]


def _mean_depth(composited: Array, alphas: Array) -> Array:
    return safe_divide(rasterizer.blended_depth(composited[None])[0, ..., 0], alphas, alphas > MIN_COVERAGE)
