"""The native loops as an engine: what `rasterizer.compositing` and `rasterizer.engines` call."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from rasterizer._native.harmonics import BANDS, CHANNELS
from rasterizer._native.similarity import MAX_IMAGE_CHANNELS, count_tiles
from rasterizer._native.tiles import GEOMETRY, MAX_SIDE
from rasterizer.binning import TileGrid, TilePairs, sigma_cuts
from rasterizer.compositing import Blended, Engine, Static
from rasterizer.ewa import Projection
from rasterizer.rules import Rules
from rasterizer.tracing import without_axes

__all__ = ["BANDS", "CHANNELS", "ENGINE", "MAX_IMAGE_CHANNELS", "call", "ssim"]


def call(handler: str, results: Any, *arguments: Array, **how: Any) -> Any:
    """What a handler of this package writes, by its name; it has the shapes and dtypes of `results`."""
    results = jax.tree.map(lambda each: jax.ShapeDtypeStruct(each.shape, each.dtype), results)
    return without_axes(jax.ffi.ffi_call(f"rasterizer_{handler}", results, vmap_method="sequential", **how), *arguments)


def _single(x: Array) -> Array:
    return x.astype(np.float32) if x.dtype == np.float64 else x


def _numbers(static: Static) -> tuple[Array, Array]:
    """What the loops read of the static part: whole numbers and rules."""
    grid, rules, front = static.grid, static.rules, static.front
    in_front, of_camera = front.channels if front else 0, grid.tiles_x * grid.tiles_y
    sizes = grid.tiles_x, of_camera, grid.tile_size, in_front, static.with_median, static.probes
    below = np.inf if rules.straight_through else rules.alpha_max
    thresholds = rules.alpha_max, rules.alpha_min, rules.transmittance_min, below, front.stop_after if front else 0
    return jnp.asarray(np.array(sizes, np.int32)), jnp.asarray(np.array(thresholds, np.float32))


def _forward(static: Static, rows: Array, lists: tuple[Array, ...]) -> Blended:
    tiles, pixels = static.grid.num_tiles, static.grid.tile_size**2
    features = jax.ShapeDtypeStruct((tiles, rows.shape[1] - GEOMETRY, pixels), np.float32)
    light, index = (jax.ShapeDtypeStruct((tiles, pixels), kind) for kind in (np.float32, np.int32))
    results = features, light, index, index
    features, light, last, median = call("forward", results, rows, *lists, *_numbers(static))
    return Blended(features, light, last, median if static.with_median else None)


def _backward(static: Static, rows: Array, lists: tuple[Array, ...], *others: Array) -> Array:
    result = jax.ShapeDtypeStruct((rows.shape[0], rows.shape[1] + static.probes), np.float32)
    return call("backward", result, rows, *lists, *others, *_numbers(static))


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
    results = [jax.ShapeDtypeStruct(shape, np.int32) for shape in ((capacity,), (grid.num_tiles + 1,), ())]
    splats, offsets, needed = call("lists", results, *_listed(projection, opacities, grid, rules, masks))
    return TilePairs(splats, offsets, needed, needed > capacity)


def ssim(image: Array, target: Array, mask: Array) -> tuple[Array, Array]:
    """`[]` sum of SSIM over the valid pixels and all channels, and `[3, H, W, C]` what `ssim_gradient` reads."""
    shapes = (count_tiles.py_func(*image.shape),), (3, *image.shape)
    sums, slopes = call("ssim", [jax.ShapeDtypeStruct(each, np.float32) for each in shapes], image, target, mask)
    return jnp.sum(sums), slopes


def _check_side(side: int) -> None:
    if side > MAX_SIDE:
        raise ValueError(f"tile_size={side} is over {MAX_SIDE}, the most that backend='native' holds")


ENGINE = Engine(_forward, _backward, bin_splats, check_side=_check_side, unlisted=_listed)
