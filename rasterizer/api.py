"""The front door: arrays in, images out. Names, argument order and conventions of gsplat."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from rasterizer import _reference
from rasterizer.arrays import in_float32, takes_arrays, whole_number
from rasterizer.binning import TileGrid, count_pairs
from rasterizer.camera_models import CameraModelName
from rasterizer.capacity import UnknownCountError, count_capacity
from rasterizer.checks import absgrad_zeros, check_arrays, check_counts, check_lenses, check_mode, maps_over_batches
from rasterizer.compositing import mask_tiles
from rasterizer.engines import Backend, bin_splats, blend, default_tile_size, lists_by_itself, resolve
from rasterizer.ewa import DepthMode, Projection, RasterizeMode
from rasterizer.features import (
    RenderMode,
    blended_depth,
    camera_normals,
    center_channels,
    depth_channels,
    drawable,
    expected_depth,
    image_features,
    median_depth,
)
from rasterizer.gsplat import Info
from rasterizer.projection import project
from rasterizer.rules import GSPLAT, Rules

LARGEST_RADIUS = 2**30  # pixels, within int32


class Arrays(NamedTuple):
    """The arguments of `rasterization` that may be traced, by their names."""

    means: Array
    quats: Array | None
    scales: Array | None
    opacities: Array
    colors: Array | None
    viewmats: Array
    Ks: Array
    covars: Array | None
    radial_coeffs: Array | None
    backgrounds: Array | None
    masks: Array | None
    means2d_probe: Array | None
    absgrad: Array | None


@dataclass(frozen=True)
class Options:
    """The static arguments of `rasterization`: one compiled program for each."""

    grid: TileGrid
    backend: Backend
    capacity: int | None
    sh_degree: int | None
    render_mode: RenderMode
    depth_mode: DepthMode
    return_median_depth: bool
    return_normals: bool
    projected: tuple[tuple[str, Any], ...]  # the static arguments of `project` but for the depth mode, by name
    rules: Rules


@partial(jax.jit, static_argnames="options")
def _rasterize(arrays: Arrays, options: Options):
    if "RGB" in options.render_mode:
        finite = drawable(arrays.colors, options.sh_degree)
        arrays = arrays._replace(opacities=jnp.where(finite, arrays.opacities, 0))
    projection, opacities = _project(arrays, options)
    features = _features(arrays, projection, options)
    image, left, median, lists = _blend(arrays, projection, opacities, features, options)
    radii = jnp.ceil(jnp.minimum(projection.extents, LARGEST_RADIUS)).astype(jnp.int32)  # gsplat's are whole
    named = projection._asdict() | {"radii": radii, "opacities": opacities} | lists
    if options.return_normals:
        named["normals"], image = image[..., :3], image[..., 3:]
    if options.return_median_depth:
        named["median_depths"] = median_depth(projection, median)
    alphas = 1 - left
    if "ED" in options.render_mode:
        image = expected_depth(image, alphas)
    if arrays.backgrounds is not None:
        behind = _behind(arrays.backgrounds, image.shape[-1], options.render_mode)
        image = image + left * behind[:, None, None, :]
    return image, alphas, Info(named, options.grid)


@partial(jax.jit, static_argnames=("grid", "projected"))
def _splats(arrays: Arrays, grid: TileGrid, projected: tuple[tuple[str, Any], ...]) -> Projection:
    shapes = arrays.means, arrays.quats, arrays.scales, arrays.opacities, arrays.viewmats, arrays.Ks
    how = {"covars": arrays.covars, "radial_coeffs": arrays.radial_coeffs, **dict(projected)}
    return project(*shapes, grid.width, grid.height, **how)


def _project(arrays: Arrays, options: Options) -> tuple[Projection, Array]:
    """The splats, and their opacities `[C, N]` as the pixels see them."""
    shows_depth = options.render_mode != "RGB" or options.return_median_depth
    depth_mode = options.depth_mode if shows_depth else "center"
    projection = _splats(arrays, options.grid, (*options.projected, ("depth_mode", depth_mode)))
    if arrays.means2d_probe is not None:
        projection = projection._replace(means2d=projection.means2d + arrays.means2d_probe)
    opacities = jnp.broadcast_to(arrays.opacities, projection.depths.shape)
    if projection.compensations is not None:
        opacities = opacities * projection.compensations
    return projection, opacities


def _features(arrays: Arrays, projection: Projection, options: Options) -> Array:
    """`[C, N, D]` what is blended: normals, colours and depth, as far as they are requested."""
    depths = None
    if options.render_mode != "RGB":
        # The oracle evaluates every splat's plane at every pixel itself.
        dense, size = options.backend == "reference", (options.grid.width, options.grid.height)
        depths = center_channels(projection) if dense else depth_channels(projection, *size)
    scene = arrays.means, arrays.colors, arrays.viewmats
    features = image_features(*scene, projection, depths, options.sh_degree, options.render_mode)
    if not options.return_normals:
        return features
    oriented = arrays.means, arrays.quats, arrays.scales, arrays.viewmats
    normals = camera_normals(*oriented, projection.visible, dict(options.projected)["camera_model"])
    return jnp.concatenate([normals, features], -1)


def _blend(arrays: Arrays, projection: Projection, opacities: Array, features: Array, options: Options):
    """Image, transmittance left, median splats, and the lists of the tiles by name."""
    grid, rules, masks = options.grid, options.rules, arrays.masks
    if options.backend == "reference":
        dense = _reference.composite(projection, opacities, features, grid.width, grid.height, rules)
        return *mask_tiles(masks, *dense, grid), {}
    pairs, named = None, {}
    if options.capacity is None:
        named = {"needed": count_pairs(projection, grid), "overflowed": jnp.array(False)}
    else:
        how = {"backend": options.backend}
        pairs = bin_splats(projection, opacities, grid, options.capacity, rules, masks, **how)
        named = pairs._asdict()
    how = {"backend": options.backend, "with_median": options.return_median_depth, "absgrad": arrays.absgrad}
    image, left, median = blend(projection, opacities, features, pairs, grid, rules, masks=masks, **how)
    if options.render_mode != "RGB":
        colors_end = image.shape[-1] - (1 if projection.slopes is None else 3)
        image = jnp.concatenate([image[..., :colors_end], blended_depth(image[..., colors_end:])], -1)
    return image, left, median, named


def _behind(backgrounds: Array, num_channels: int, render_mode: RenderMode) -> Array:
    """`[C, X]` backgrounds; where only those of the colours are given, depth has zero, as in gsplat."""
    if backgrounds.shape[-1] == num_channels:
        return backgrounds
    of_colors = backgrounds if "RGB" in render_mode else backgrounds[:, :0]
    return jnp.pad(of_colors, ((0, 0), (0, num_channels - of_colors.shape[-1])))


@takes_arrays
@maps_over_batches
def rasterization(
    means: Float[Array, "... N 3"],
    quats: Float[Array, "... N 4"] | None,
    scales: Float[Array, "... N 3"] | None,
    opacities: Float[Array, "... N"],
    colors: Float[Array, "... D"] | None,
    viewmats: Float[Array, "... C 4 4"],
    Ks: Float[Array, "... C 3 3"],
    width: int,
    height: int,
    *,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    backgrounds: Float[Array, "... C B"] | Float[Array, ""] | None = None,
    masks: Bool[Array, "... C tiles_y tiles_x"] | None = None,
    covars: Float[Array, "... N 3 3"] | None = None,
    render_mode: RenderMode = "RGB",
    rasterize_mode: RasterizeMode = "classic",
    depth_mode: DepthMode = "center",
    camera_model: CameraModelName = "pinhole",
    radial_coeffs: Float[Array, "... C 4"] | None = None,
    return_median_depth: bool = False,
    return_normals: bool = False,
    means2d_probe: Float[Array, "... C N 2"] | None = None,
    absgrad: Float[Array, "... C N 2"] | bool = False,
    tile_size: int | None = None,
    capacity: int | None = None,
    backend: Backend = "auto",
    rules: Rules = GSPLAT,
) -> tuple[Float[Array, "... C {height} {width} X"], Float[Array, "... C {height} {width} 1"], Info]:
    """Render N Gaussians into C cameras.

    The leading dimensions of `means` are those of several scenes. An array without them is the same for all scenes.

    Arrays are JAX's or numpy's of any real dtype, or lists of numbers. Tiles are computed in float32, and the reference
    in the dtype of `means` (float64, else float32). A gradient has the dtype of the array that was passed.
    Array arguments are differentiable (means, quats, scales, covars, opacities, colors, viewmats, Ks, radial_coeffs,
    backgrounds); the rest is static, a new value compiles anew. Camera matrices are traced: a new camera does not.

    Args:
        means: World positions.
        quats: Rotations (w, x, y, z), any length; None with `covars`.
        scales: Standard deviations, linear; None with `covars`.
        opacities: In 0..1.
        colors: `[N, D]` or `[C, N, D]` channels of any meaning, or SH coefficients `[N, K, 3]` with `sh_degree`;
            may be None where only depth is rendered.
        viewmats: World to camera, OpenCV axes (x right, y down, z forward).
        Ks: Pixels; pixel centres at +0.5.
        width: Image width in pixels.
        height: Image height in pixels.
        near_plane: Gaussians at or nearer than this camera z are culled.
        far_plane: Gaussians at or beyond this camera z are culled.
        radius_clip: Gaussians whose radii are both at most this are culled, pixels.
        eps2d: Added to both variances of a splat, pixels^2 (the low-pass filter of 3DGS).
        sh_degree: Degree of the harmonics in `colors`, 0 to 4; None where colors are colours.
        backgrounds: Blended under each image: X channels, or those of the colours alone, and depth then has zero.
            A number applies to all channels of the colours; for the depth where there is nothing else.
        masks: A tile that is False is not rendered: background, alpha 0.
        covars: Symmetric covariances in place of quats and scales.
        render_mode: What X holds: "RGB" the channels of `colors`; "D" depth blended like a colour; "ED" depth divided
            by alpha; "RGB+D" and "RGB+ED" both, depth last. Depth is camera z.
        rasterize_mode: "antialiased" dims each splat by what the low-pass filter widened it (Mip-Splatting).
        depth_mode: What a splat's depth is: "center" that of its mean, at every pixel; "plane" where the Gaussian is
            densest along the pixel's ray, a plane over the splat (see `rasterizer.project`). In all depth modes, and
            in the median depth. Gradients then reach quats and scales too.
        camera_model: "pinhole"; "ortho", a parallel projection, `fx` and `fy` in pixels per scene unit; "fisheye",
            equidistant, up to 90 degrees off the axis. The affine map of a splat is that of its mean.
        radial_coeffs: k1 to k4 of a fisheye lens (Kannala and Brandt, OpenCV's order). What is past the
            angle at which its image stops to grow is culled.
        return_median_depth: Adds `median_depths` `[C, H, W, 1]`: depth of the splat in which a pixel's light falls to
            one half, of the last one that shows where it does not, 0 where none does.
        return_normals: Adds `normals` `[C, H, W, 3]`: the Gaussians' smallest axes in the camera's frame, facing it,
            blended like colours over zero.
        means2d_probe: Zeros, added to the projected means: the gradient to them is what torch keeps in
            gsplat's `means2d.grad`.
        absgrad: Zeros: the image does not depend on them, and their gradient is what gsplat's
            `absgrad=True` writes to `means2d.absgrad`, the sum over pixels of absolute gradients to `means2d`.
        tile_size: Side of a tile in pixels; None for what suits the backend, `rasterizer.default_tile_size(backend)`.
        capacity: Length of the buffer of (tile, Gaussian) pairs. None counts first and chooses a bucket, which works
            eagerly, under `grad` and under `vmap`. Inside `jit` "native" lists the pairs in memory of its own, and the
            results lack `splats` and `offsets`; the other tile backends need a number there.
        backend: "native" tiles in loops that numba compiles for this CPU, "xla" tiles in jnp, "pallas" tiles in GPU
            kernels, "reference" the dense oracle (float64 too, any order of derivatives), "auto" the fastest on this
            machine.
        rules: Thresholds of compositing; presets `rasterizer.GSPLAT`, `GSPLAT_1_5` and `INRIA`, and `SMOOTH` without
            cuts.

    Returns:
        The image, the alphas, and the intermediate results by name, a mapping: `means2d`,
        `depths`, `conics`, `extents`, `radii` (extents rounded up, as gsplat has them), `visible`, `opacities`
        `[C, N]`, `compensations`, `slopes` (of plane depth, else None), what was requested above, and for the tile
        backends `splats`, `offsets`, `needed`, `overflowed`. With a capacity given, an image whose `overflowed` is true
        is incomplete and must not be used. gsplat's other keys are computed when they are read (`rasterizer.gsplat`).

    Raises:
        ValueError: On shapes, modes or degrees that do not fit, with the value in the message.
        TypeError: On what is no array, such as a tensor of torch. In forward mode or differentiated twice, unless the
            backend is "reference".
    """
    check_mode(RenderMode, render_mode=render_mode)
    check_mode(RasterizeMode, rasterize_mode=rasterize_mode)
    check_mode(DepthMode, depth_mode=depth_mode)
    check_mode(CameraModelName, camera_model=camera_model)
    check_mode(Backend, backend=backend)
    width, height = whole_number("width", width, 1), whole_number("height", height, 1)
    tile_size, capacity = whole_number("tile_size", tile_size, 1), whole_number("capacity", capacity, 1)
    sh_degree = whole_number("sh_degree", sh_degree, 0)
    check_counts(means, viewmats, colors)
    if backgrounds is not None and backgrounds.ndim == 0:
        behind = colors.shape[-1] if colors is not None and "RGB" in render_mode else 1
        backgrounds = jnp.broadcast_to(backgrounds, (viewmats.shape[0], behind))
    if return_normals and covars is not None:
        raise ValueError("return_normals needs quats and scales: a covariance does not name its axes")
    zeros = absgrad_zeros(absgrad, (viewmats.shape[0], means.shape[0], 2))
    if zeros is not None and backend == "reference":
        raise ValueError("absgrad needs a tile backend, not 'reference'")
    check_lenses(camera_model, radial_coeffs, near_plane)
    backend = resolve(backend)
    grid = TileGrid(viewmats.shape[0], width, height, tile_size or default_tile_size(backend))
    scene = means, quats, scales, opacities, colors, viewmats, Ks, covars, radial_coeffs, backgrounds, masks
    arrays = Arrays(*scene, means2d_probe, zeros)
    check_arrays(arrays._asdict(), means.shape[0], grid, sh_degree, render_mode)
    if backend != "reference":
        arrays = jax.tree.map(in_float32, arrays)
    projected = {"eps2d": eps2d, "near_plane": near_plane, "far_plane": far_plane, "radius_clip": radius_clip}
    projected |= {"rasterize_mode": rasterize_mode, "camera_model": camera_model, "backend": backend, "rules": rules}
    projected = tuple(projected.items())
    if capacity is None and backend != "reference":
        try:
            # No other array changes the count, and each of another shape would compile it again.
            shapes = arrays._replace(colors=None, backgrounds=None, masks=None, means2d_probe=None, absgrad=None)
            capacity = count_capacity(_splats(jax.lax.stop_gradient(shapes), grid, projected), grid)
        except UnknownCountError:
            if zeros is not None or not lists_by_itself(backend):
                raise
    outputs = sh_degree, render_mode, depth_mode, return_median_depth, return_normals
    return _rasterize(arrays, Options(grid, backend, capacity, *outputs, projected, rules))
