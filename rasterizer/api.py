"""The front door: arrays in, images out. Names, argument order and conventions of gsplat."""

from functools import partial
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from rasterizer import _reference, _xla
from rasterizer.binning import TileGrid, TilePairs, bin_splats, count_pairs
from rasterizer.harmonics import spherical_harmonics
from rasterizer.projection import Projection, project
from rasterizer.rules import GSPLAT, Rules

RenderMode = Literal["RGB", "D", "ED", "RGB+D", "RGB+ED"]
Backend = Literal["auto", "xla", "reference"]

TILE_SIZE = 8  # Half the wasted pixels of 16 for small splats, measured on CPU.


def _check(means, quats, scales, opacities, colors, viewmats, Ks, backgrounds, sh_degree, render_mode, backend):
    num_gaussians, num_cameras = means.shape[0], viewmats.shape[0]
    expected = {
        "means": (means, (num_gaussians, 3)),
        "quats": (quats, (num_gaussians, 4)),
        "scales": (scales, (num_gaussians, 3)),
        "opacities": (opacities, (num_gaussians,)),
        "viewmats": (viewmats, (num_cameras, 4, 4)),
        "Ks": (Ks, (num_cameras, 3, 3)),
    }
    for name, (array, shape) in expected.items():
        if array.shape != shape:
            raise ValueError(f"{name}.shape={array.shape}, expected {shape} for {num_gaussians} Gaussians")
    leading = (num_gaussians,) if colors.ndim == 2 or sh_degree is not None else (num_cameras, num_gaussians)
    if colors.shape[: len(leading)] != leading or colors.ndim != len(leading) + (1 if sh_degree is None else 2):
        kind = "[N, K, 3] with sh_degree" if sh_degree is not None else "[N, D] or [C, N, D]"
        raise ValueError(f"colors.shape={colors.shape}, expected {kind} with N={num_gaussians}, C={num_cameras}")
    if render_mode not in get_args(RenderMode):
        raise ValueError(f"{render_mode=} is not one of {get_args(RenderMode)}")
    if backend not in get_args(Backend):
        raise ValueError(f"{backend=} is not one of {get_args(Backend)}")
    channels = (colors.shape[-1] if "RGB" in render_mode else 0) + ("D" in render_mode.replace("RGB", ""))
    if backgrounds is not None and backgrounds.shape != (num_cameras, channels):
        raise ValueError(f"{backgrounds.shape=}, expected {(num_cameras, channels)} for {render_mode=}")
    arrays = {name: array for name, (array, _) in expected.items()} | {"colors": colors, "backgrounds": backgrounds}
    dtypes = {name: jax.dtypes.canonicalize_dtype(a.dtype) for name, a in arrays.items() if a is not None}
    for name, dtype in dtypes.items():
        if not jnp.issubdtype(dtype, jnp.floating) or dtype != dtypes["means"]:
            raise ValueError(f"{name}.dtype={dtype}, expected one float dtype for all, means.dtype={dtypes['means']}")
        if backend != "reference" and dtype != jnp.float32:
            raise ValueError(f"{name}.dtype={dtype}, the tile backends compute in float32: pass backend='reference'")


def _drawable(colors, sh_degree) -> Array:
    """`[N]` whether all of a Gaussian's colours are finite: one NaN would spread to every pixel that it touches."""
    gaussian_axis = 1 if colors.ndim == 3 and sh_degree is None else 0
    return jnp.isfinite(colors).all([axis for axis in range(colors.ndim) if axis != gaussian_axis])


def _features(means, colors, viewmats, projection: Projection, sh_degree, render_mode) -> Array:
    """`[C, N, X]` what is blended: colours (from harmonics where asked) and, last, depth."""
    num_cameras = viewmats.shape[0]
    parts = []
    if "RGB" in render_mode:
        if sh_degree is not None:
            centers = -jnp.sum(viewmats[:, :3, :3] * viewmats[:, :3, 3, None], axis=1)
            usable = projection.visible[..., None]
            dirs = jnp.where(usable, means[None] - centers[:, None], jnp.array([0, 0, 1], means.dtype))
            coeffs = jnp.where(usable[..., None], colors[None], 0)
            parts.append(jnp.maximum(spherical_harmonics(sh_degree, dirs, coeffs) + 0.5, 0))
        else:
            colors = colors if colors.ndim == 3 else jnp.broadcast_to(colors[None], (num_cameras, *colors.shape))
            parts.append(jnp.where(projection.visible[..., None], colors, 0))
    if render_mode != "RGB":
        parts.append(jnp.where(projection.visible, projection.depths, 0)[..., None])
    return jnp.concatenate(parts, -1)


def blend(
    projection: Projection,
    opacities: Array,
    features: Array,
    pairs: TilePairs,
    grid: TileGrid,
    rules: Rules = GSPLAT,
) -> tuple[Array, Array]:
    """Blend any channels over lists that are already there: one binning serves several passes.

    Args:
        projection: Splats of `grid.num_cameras` cameras.
        opacities: `[N]`.
        features: `[C, N, D]`.
        pairs: Lists of `bin_splats` for this projection and grid.
        grid: The tiles. Static.
        rules: Thresholds. Static.

    Returns:
        `[C, H, W, D]` features blended on nothing and `[C, H, W, 1]` transmittance left. Differentiable to
        `means2d` and `conics` of the projection, opacities and features.
    """
    num_cameras = grid.num_cameras
    if features.shape[1] == 0:
        shape = (num_cameras, grid.height, grid.width)
        return jnp.zeros((*shape, features.shape[2]), features.dtype), jnp.ones((*shape, 1), features.dtype)
    opacities = jnp.where(projection.visible, opacities, 0)
    return _xla.composite(
        _xla.Static(grid, rules),
        projection.means2d.reshape(-1, 2),
        projection.conics.reshape(-1, 3),
        opacities.reshape(-1),
        features.reshape(num_cameras * features.shape[1], features.shape[2]),
        pairs.splats,
        pairs.offsets,
    )


@partial(
    jax.jit,
    static_argnames=(
        [
            "width",
            "height",
            "near_plane",
            "far_plane",
            "eps2d",
            "sh_degree",
            "render_mode",
            "tile_size",
            "capacity",
            "backend",
            "rules",
        ]
    ),
)
def _rasterize(
    means,
    quats,
    scales,
    opacities,
    colors,
    viewmats,
    Ks,
    backgrounds,
    *,
    width,
    height,
    near_plane,
    far_plane,
    eps2d,
    sh_degree,
    render_mode,
    tile_size,
    capacity,
    backend,
    rules,
):
    if "RGB" in render_mode:
        opacities = jnp.where(_drawable(colors, sh_degree), opacities, 0)
    projection = project(
        means,
        quats,
        scales,
        opacities,
        viewmats,
        Ks,
        width,
        height,
        eps2d=eps2d,
        near_plane=near_plane,
        far_plane=far_plane,
        rules=rules,
    )
    features = _features(means, colors, viewmats, projection, sh_degree, render_mode)
    info = projection._asdict()
    if backend == "reference":
        opacities = jnp.broadcast_to(opacities, projection.depths.shape)
        image, left = _reference.composite(projection, opacities, features, width, height, rules)
    else:
        grid = TileGrid(viewmats.shape[0], width, height, tile_size)
        per_camera = jnp.broadcast_to(opacities, projection.depths.shape).reshape(-1)
        pairs = bin_splats(projection, per_camera, grid, capacity, rules)
        image, left = blend(projection, opacities, features, pairs, grid, rules)
        info |= pairs._asdict()
    alphas = 1 - left
    if "ED" in render_mode:
        # An empty pixel has depth 0 and no gradient: the divisor is made safe first.
        covered = alphas > 0
        expected = jnp.where(covered, image[..., -1:] / jnp.where(covered, alphas, 1), 0)
        image = jnp.concatenate([image[..., :-1], expected], -1)
    if backgrounds is not None:
        image = image + left * backgrounds[:, None, None, :]
    return image, alphas, info


@jax.custom_batching.custom_vmap
def _largest(count: Array) -> Array:
    """The count itself; under `vmap`, the largest of the batch, unbatched."""
    return count


@_largest.def_vmap
def _largest_of_batch(axis_size, in_batched, count):
    del axis_size, in_batched
    return jnp.max(count), False


def capacity_bucket(needed: int) -> int:
    """The next power of two, or the one and a half times a power of two, that holds `needed` pairs.

    Raises:
        ValueError: If `needed` is the largest int32, which stands for "does not fit".
    """
    if needed >= np.iinfo(np.int32).max:
        raise ValueError(f"{needed} or more (tile, Gaussian) pairs do not fit 32-bit indices: render fewer or smaller")
    power = 1 << max(needed - 1, 255).bit_length()
    return power * 3 // 4 if needed <= power * 3 // 4 else power


@partial(jax.jit, static_argnames=("grid", "eps2d", "near_plane", "far_plane", "rules"))
def _count(means, quats, scales, opacities, viewmats, Ks, grid, **options):
    return count_pairs(project(means, quats, scales, opacities, viewmats, Ks, grid.width, grid.height, **options), grid)


def _choose_capacity(means, quats, scales, opacities, viewmats, Ks, grid, options) -> int:
    arrays = jax.lax.stop_gradient((means, quats, scales, opacities, viewmats, Ks))
    count = _count(*arrays, grid, **options)
    try:
        return capacity_bucket(int(_largest(count)))
    except jax.errors.ConcretizationTypeError:
        raise ValueError(
            "inside jit the number of (tile, Gaussian) pairs is not known: pass capacity=..., "
            "check info['overflowed'], and retry with at least info['needed']"
        ) from None


def rasterization(
    means: Array,
    quats: Array,
    scales: Array,
    opacities: Array,
    colors: Array,
    viewmats: Array,
    Ks: Array,
    width: int,
    height: int,
    *,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    backgrounds: Array | None = None,
    render_mode: RenderMode = "RGB",
    tile_size: int | None = None,
    capacity: int | None = None,
    backend: Backend = "auto",
    rules: Rules = GSPLAT,
) -> tuple[Array, Array, dict[str, Any]]:
    """Render N Gaussians into C cameras.

    Array arguments are differentiable (means, quats, scales, opacities, colors, viewmats, Ks, backgrounds); the rest
    is static, a new value compiles anew. Camera matrices are traced: a new camera does not.

    Args:
        means: `[N, 3]` world positions.
        quats: `[N, 4]` rotations (w, x, y, z), any length.
        scales: `[N, 3]` standard deviations, linear.
        opacities: `[N]` in 0..1.
        colors: `[N, D]` or `[C, N, D]` channels of any meaning, or SH coefficients `[N, K, 3]` with `sh_degree`.
        viewmats: `[C, 4, 4]` world to camera, OpenCV axes (x right, y down, z forward).
        Ks: `[C, 3, 3]` pixels; pixel centres at +0.5.
        width: Image width in pixels.
        height: Image height in pixels.
        near_plane: Gaussians at or nearer than this camera z are culled.
        far_plane: Gaussians at or beyond this camera z are culled.
        eps2d: Added to both variances of a splat, pixels^2 (the low-pass filter of 3DGS).
        sh_degree: Degree of the harmonics in `colors`, 0 to 4; None where colors are colours.
        backgrounds: `[C, X]` blended under each image.
        render_mode: What X holds: "RGB" the channels of `colors`; "D" depth blended like a colour; "ED" depth divided
            by alpha; "RGB+D" and "RGB+ED" both, depth last. Depth is camera z.
        tile_size: Side of a tile in pixels.
        capacity: Length of the buffer of (tile, Gaussian) pairs. None counts first and chooses a bucket, which works
            eagerly, under `grad` and under `vmap`; inside `jit` a number must be given.
        backend: "xla" tiles, "reference" the dense oracle (any dtype, any order of derivatives), "auto" the fastest.
        rules: Thresholds of compositing; presets `rasterizer.GSPLAT` and `rasterizer.INRIA`.

    Returns:
        `[C, H, W, X]` image, `[C, H, W, 1]` alphas, and a dict of the intermediate results: `means2d`, `depths`,
        `conics`, `extents`, `visible`, and for the tile backends `splats`, `offsets`, `needed`, `overflowed`. With a
        capacity given, an image whose `overflowed` is true is incomplete and must not be used.

    Raises:
        ValueError: On shapes, dtypes, modes or degrees that do not fit, with the value in the message.
    """
    _check(means, quats, scales, opacities, colors, viewmats, Ks, backgrounds, sh_degree, render_mode, backend)
    tile_size = TILE_SIZE if tile_size is None else tile_size
    for name, size in {"width": width, "height": height, "tile_size": tile_size, "capacity": capacity}.items():
        if size is not None and size < 1:
            raise ValueError(f"{name}={size}, expected at least 1")
    backend = "xla" if backend == "auto" else backend
    options = {"eps2d": eps2d, "near_plane": near_plane, "far_plane": far_plane, "rules": rules}
    if capacity is None and backend != "reference":
        grid = TileGrid(viewmats.shape[0], width, height, tile_size)
        capacity = _choose_capacity(means, quats, scales, opacities, viewmats, Ks, grid, options)
    return _rasterize(
        means,
        quats,
        scales,
        opacities,
        colors,
        viewmats,
        Ks,
        backgrounds,
        width=width,
        height=height,
        sh_degree=sh_degree,
        render_mode=render_mode,
        tile_size=tile_size,
        capacity=capacity,
        backend=backend,
        **options,
    )
