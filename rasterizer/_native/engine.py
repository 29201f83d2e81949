"""The native loops as an engine: what `rasterizer.compositing` and `rasterizer.engines` call."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from rasterizer._native import harmonics as _harmonics
from rasterizer._native import lists as _lists
from rasterizer._native import passes as _passes
from rasterizer._native import projection as _projection
from rasterizer._native import similarity as _similarity
from rasterizer._native import updates as _updates
from rasterizer._native.tiles import GEOMETRY, MAX_SIDE
from rasterizer.binning import TileGrid, TilePairs, sigma_cuts
from rasterizer.compositing import Blended, Engine, Static
from rasterizer.ewa import Projection
from rasterizer.rules import Rules

BANDS, CHANNELS, MAX_IMAGE_CHANNELS = _harmonics.BANDS, _harmonics.CHANNELS, _similarity.MAX_IMAGE_CHANNELS


def _call(handler, results, *arguments, **how):
    name = f"rasterizer_{handler.__name__}"
    return jax.ffi.ffi_call(name, results, vmap_method="sequential", **how)(*arguments)


def _single(x: Array) -> Array:
    return x.astype(np.float32) if x.dtype == np.float64 else x


def _numbers(static: Static) -> tuple[Array, Array]:
    """What the loops read of the static part: whole numbers and rules."""
    grid, rules, front = static.grid, static.rules, static.front
    sizes = (
        grid.tiles_x,
        grid.tiles_x * grid.tiles_y,
        grid.tile_size,
        front.channels if front else 0,
        static.with_median,
        static.probes,
    )
    below = np.inf if rules.straight_through else rules.alpha_max
    thresholds = rules.alpha_max, rules.alpha_min, rules.transmittance_min, below, front.stop_after if front else 0
    return jnp.asarray(np.array(sizes, np.int32)), jnp.asarray(np.array(thresholds, np.float32))


def _forward(static: Static, rows: Array, lists: tuple[Array, ...]) -> Blended:
    tiles, pixels = static.grid.num_tiles, static.grid.tile_size**2
    indices = jax.ShapeDtypeStruct((tiles, pixels), np.int32)
    features = jax.ShapeDtypeStruct((tiles, rows.shape[1] - GEOMETRY, pixels), np.float32)
    results = features, jax.ShapeDtypeStruct((tiles, pixels), np.float32), indices, indices
    features, light, last, median = _call(_passes.forward, results, rows, *lists, *_numbers(static))
    return Blended(features, light, last, median if static.with_median else None)


def _backward(static: Static, rows: Array, lists: tuple[Array, ...], *others: Array) -> Array:
    result = jax.ShapeDtypeStruct((rows.shape[0], rows.shape[1] + static.probes), np.float32)
    return _call(_passes.backward, result, rows, *lists, *others, *_numbers(static))


def _listed(
    projection: Projection, opacities: Array, grid: TileGrid, rules: Rules, masks: Array | None
) -> tuple[Array, ...]:
    """What the lists are made of: the arguments of `lists.lists`, not differentiable."""
    # In float32, whatever comes: the lists only name what is blended.
    p = jax.tree.map(lambda x: jax.lax.stop_gradient(_single(x)), projection)
    opacities = jax.lax.stop_gradient(_single(opacities))
    cuts = sigma_cuts(jnp.broadcast_to(opacities, p.depths.shape), rules)
    sizes = np.array([grid.tiles_x, grid.tiles_y, grid.tile_size, grid.num_cameras], np.int32)
    tile_mask = jnp.zeros(0, bool) if masks is None else masks.reshape(-1)
    return (
        p.means2d.reshape(-1, 2),
        p.conics.reshape(-1, 3),
        p.depths.reshape(-1),
        p.extents.reshape(-1, 2),
        p.visible.reshape(-1),
        cuts.reshape(-1),
        tile_mask,
        jnp.asarray(sizes),
    )


def bin_splats(
    projection: Projection,
    opacities: Array,
    grid: TileGrid,
    capacity: int,
    rules: Rules,
    masks: Array | None = None,
) -> TilePairs:
    """`binning.bin_splats` as native loops: the same lists. Slots past them are not written."""
    results = (
        jax.ShapeDtypeStruct((capacity,), np.int32),
        jax.ShapeDtypeStruct((grid.num_tiles + 1,), np.int32),
        jax.ShapeDtypeStruct((), np.int32),
    )
    listed = _listed(projection, opacities, grid, rules, masks)
    splats, offsets, needed = _call(_lists.lists, results, *listed)
    return TilePairs(splats, offsets, needed, needed > capacity)


def project(with_factors: bool, with_slopes: bool, *arrays: Array) -> Projection:
    """`rasterizer.project` of means, quats, scales, opacities, viewmats, Ks and options (see `_native.projection`).

    Compensations and slopes are empty where they are not wanted.
    """
    splats = arrays[4].shape[0], arrays[0].shape[0]
    widths = (2,), (), (3,), (), (2,), (2,)
    are_wanted = True, True, True, with_factors, with_slopes, True
    shapes = [(*splats, *width) if is_wanted else (0,) for width, is_wanted in zip(widths, are_wanted, strict=True)]
    results = [*(jax.ShapeDtypeStruct(shape, np.float32) for shape in shapes), jax.ShapeDtypeStruct(splats, bool)]
    means2d, depths, conics, factors, slopes, extents, visible = _call(_projection.project, results, *arrays)
    return Projection(means2d, depths, conics, extents, visible, factors, slopes)


def project_gradient(*arrays: Array) -> list[Array]:
    """Gradients to means, quats and scales, given what `project` was and the cotangents of its differentiable parts."""
    return _call(
        _projection.project_gradient, [jax.ShapeDtypeStruct(each.shape, np.float32) for each in arrays[:3]], *arrays
    )


def adam(parameters: Array, gradients: Array, mu: Array, nu: Array, numbers: Array, skipped: Array) -> list[Array]:
    """Parameters and moments of `rasterizer.adam` after a step, in the place of those before it."""
    result = jax.ShapeDtypeStruct(parameters.shape, np.float32)
    places = {0: 0, 2: 1, 3: 2}
    arguments = parameters, gradients, mu, nu, numbers, skipped
    return _call(_updates.adam, [result] * 3, *arguments, input_output_aliases=places)


def all_finite(*arrays: Array) -> Array:
    """`rasterizer.all_finite` of float32 arrays."""
    return _call(_updates.all_finite, jax.ShapeDtypeStruct((), bool), *arrays)


def ssim(image: Array, target: Array, mask: Array) -> tuple[Array, Array]:
    """`[]` sum of SSIM over the valid pixels and all channels, and `[3, H, W, C]` what `ssim_gradient` reads."""
    height, width, channels = image.shape
    tiles = -(-height // _similarity.TILE_ROWS) * -(-width // (_similarity.WIDTH // channels))
    results = jax.ShapeDtypeStruct((tiles,), np.float32), jax.ShapeDtypeStruct((3, *image.shape), np.float32)
    sums, slopes = _call(_similarity.ssim, results, image, target, mask)
    return jnp.sum(sums), slopes


def ssim_gradient(image: Array, target: Array, mask: Array, slopes: Array, cotangent: Array) -> Array:
    """`[H, W, C]` gradient of that sum to the image."""
    return _call(
        _similarity.ssim_gradient, jax.ShapeDtypeStruct(image.shape, np.float32), image, target, mask, slopes, cotangent
    )


def upper_bands(dirs: Array, coeffs: Array, weights: Array) -> Array:
    """`[N, 3]` values of `rasterizer.upper_bands`; `weights` have one row or N."""
    return _call(_harmonics.upper_bands, jax.ShapeDtypeStruct(dirs.shape, np.float32), dirs, coeffs, weights)


def upper_bands_gradient(dirs: Array, coeffs: Array, weights: Array, cotangents: Array) -> tuple[Array, Array]:
    """Gradients to directions and coefficients."""
    results = [jax.ShapeDtypeStruct(each.shape, np.float32) for each in (dirs, coeffs)]
    d_dirs, d_coeffs = _call(_harmonics.upper_bands_gradient, results, dirs, coeffs, weights, cotangents)
    return d_dirs, d_coeffs


def _check_side(side: int) -> None:
    if side > MAX_SIDE:
        raise ValueError(f"tile_size={side} is over {MAX_SIDE}, the most that backend='native' holds")


_UNLISTED = Engine(_forward, _backward, _listed, takes_probes=True)
ENGINE = Engine(_forward, _backward, bin_splats, check_side=_check_side, takes_probes=True, unlisted=_UNLISTED)
