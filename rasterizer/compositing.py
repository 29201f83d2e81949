"""Compositing of listed splats: one `custom_vjp` around the engine that blends the tiles.

An engine is two functions, forward and backward over tiles. The layout and the chain rule from a tile's moments to
means and conics are the same for all engines. The chain rule is applied once per (tile, splat) pair.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from rasterizer.binning import TileGrid, TilePairs, bin_splats
from rasterizer.covariances import components
from rasterizer.rules import Rules
from rasterizer.tracing import without_axes


class Front(NamedTuple):
    """Channels that end with the first layers, while the others are blended to the end. Hashable, static.

    They see the light down to a transmittance of `stop_after`: the splat that would leave less counts with what is
    missing to that, nothing behind it counts. Weights are continuous in all alphas.
    """

    channels: int  # the last so many
    stop_after: float


class Blended(NamedTuple):
    """The results of an engine's forward pass over T tiles of P pixels."""

    features: Array  # [T, D, P]
    transmittance: Array  # [T, P]
    last: Array  # [T, P] int32 place of the last contributing splat in its tile's list, -1 for none
    median: Array | None  # [T, P] int32 last contributing splat with more than half the light left in front of it
    residuals: tuple[Array, ...] = ()  # what only the engine's own backward pass reads


class Engine(NamedTuple):
    """The two passes over tiles, and the function that lists their splats. Hashable, static."""

    # (static, rows, lists) -> Blended. rows [M, 6 + D]: x, y, conic xx xy yy, opacity, features, so that one gather per
    # pair fetches all; lists: splats and offsets of `TilePairs`.
    forward: Callable[..., Blended]
    # (static, rows, lists, transmittance, last, d_features, d_transmittance, *residuals) -> [M, 6 + D], dL/drows.
    # Probes have no column in `rows`; the last columns of `d_features` and of the result are theirs.
    backward: Callable[..., Array]
    # (projection, opacities, grid, capacity, rules, masks) -> TilePairs
    list_splats: Callable[..., TilePairs] = bin_splats
    tile_size: int = 8  # default side of a tile, pixels
    check_side: Callable[[int], None] = lambda _: None  # raises ValueError for a side that the passes cannot hold
    # (projection, opacities, grid, rules, masks) -> what both passes take for `lists` to list splats in memory of their
    # own: arrays without gradient. None: they cannot.
    unlisted: Callable[..., tuple[Array, ...]] | None = None


class Static(NamedTuple):
    """What a compiled compositor is specialised on."""

    grid: TileGrid
    rules: Rules
    engine: Engine
    with_median: bool = False
    front: Front | None = None
    probes: int = 0  # channels of zeros: the image has them for their gradient alone
    # (static, rows, ..., d_transmittance) -> [M, 2] absolute gradients to means, summed over pixels; None: not computed
    absolute: Callable[..., Array] | None = None


def pixel_centers(grid: TileGrid, arange: Callable[..., Any] = np.arange) -> tuple[Any, Any]:
    """`[P]` x and y of a tile's pixel centres, relative to the tile's centre (small numbers round less).

    They are constants; those of `jnp.arange` are computed, since a GPU kernel holds no constant arrays.
    """
    size = grid.tile_size
    index, middle = arange(size * size, dtype=np.int32), size / 2 - 0.5
    return (index % size).astype(np.float32) - middle, (index // size).astype(np.float32) - middle


def moment_basis(x: Array, y: Array) -> list[Array]:
    """What dL/dsigma is summed against: the chain rule to a splat's mean and conic needs no more."""
    return [jnp.ones_like(x), x, y, x * x, x * y, y * y]


def tile_centers(tiles: Array, grid: TileGrid) -> tuple[Array, Array]:
    """Image position x and y of the tiles' centres, pixels; of one tile or many."""
    within, size = tiles % (grid.tiles_x * grid.tiles_y), grid.tile_size
    x, y = within % grid.tiles_x * size, within // grid.tiles_x * size
    return x.astype(jnp.float32) + size / 2, y.astype(jnp.float32) + size / 2


def to_tiles(image: Array, grid: TileGrid) -> Array:
    """`[C, H, W, D]` -> `[num_tiles, D, P]`, zero beyond the image border."""
    size, channels = grid.tile_size, image.shape[-1]
    pad_y, pad_x = grid.tiles_y * size - grid.height, grid.tiles_x * size - grid.width
    padded = jnp.pad(image, ((0, 0), (0, pad_y), (0, pad_x), (0, 0)))
    blocks = padded.reshape(grid.num_cameras, grid.tiles_y, size, grid.tiles_x, size, channels)
    return blocks.transpose(0, 1, 3, 5, 2, 4).reshape(grid.num_tiles, channels, size * size)


def to_image(tiles: Array, grid: TileGrid) -> Array:
    """`[num_tiles, D, P]` -> `[C, H, W, D]`."""
    size, channels = grid.tile_size, tiles.shape[1]
    blocks = tiles.reshape(grid.num_cameras, grid.tiles_y, grid.tiles_x, channels, size, size)
    image = blocks.transpose(0, 1, 4, 2, 5, 3).reshape(
        grid.num_cameras, grid.tiles_y * size, grid.tiles_x * size, channels
    )
    return image[:, : grid.height, : grid.width]


def moments_about_means(rows: Array, centers: tuple[Array, Array], moments: Array) -> Array:
    """`[..., 6]` moments of dL/dsigma over a tile's pixels, moved from the tile's centre to the splat's mean.

    Both are sums against `moment_basis`: of the pixels relative to the centre, whose x and y are `[...]`, and of the
    offsets d = mean - pixel. A splat that shows far nearer to its mean than to the centre loses digits, as the square
    of that ratio.
    """
    x, y = rows[..., 0] - centers[0], rows[..., 1] - centers[1]
    m1, mx, my, mxx, mxy, myy = components(moments)
    dxx, dyy = x * (x * m1 - 2 * mx) + mxx, y * (y * m1 - 2 * my) + myy
    return jnp.stack([m1, x * m1 - mx, y * m1 - my, dxx, x * y * m1 - x * my - y * mx + mxy, dyy], -1)


def chain_to_rows(rows: Array, moments: Array, d_features: Array) -> Array:
    """`[..., 6 + D]` gradients to splat rows, given `[..., 6]` moments about the means and `[..., D]` dL/dfeatures."""
    xx, xy, yy = components(rows[..., 2:5])
    d1, dx, dy, dxx, dxy, dyy = components(moments)
    opacity = jnp.where(rows[..., 5] > 0, rows[..., 5], 1)
    shape = jnp.stack([xx * dx + xy * dy, xy * dx + yy * dy, 0.5 * dxx, dxy, 0.5 * dyy, -d1 / opacity], -1)
    return jnp.concatenate([shape, d_features], -1)


def mask_tiles(masks: Array | None, image: Array, left: Array, median: Array | None, grid: TileGrid):
    """The results of `rasterizer.blend` without what is in the tiles whose mask is False."""
    if masks is None:
        return image, left, median
    masks = masks.reshape(grid.num_cameras, grid.tiles_y, grid.tiles_x)
    pixels = jnp.repeat(jnp.repeat(masks, grid.tile_size, 1), grid.tile_size, 2)[:, : grid.height, : grid.width]
    median = None if median is None else jnp.where(pixels, median, -1)
    return jnp.where(pixels[..., None], image, 0), jnp.where(pixels[..., None], left, 1), median


def splats_at(places: Array, splats: Array, offsets: Array) -> Array:
    """`[T, P]` splats at places of their tiles' lists; -1 where a place is -1."""
    return jnp.where(places >= 0, splats[offsets[:-1, None] + jnp.maximum(places, 0)], -1)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def composite(
    static: Static,
    means2d: Array,
    conics: Array,
    opacities: Array,
    features: Array,
    lists: tuple[Array, ...],
    absgrad: Array | None = None,
    probes: Array | None = None,
):
    """Blend the listed splats front to back.

    Args:
        static: Tile grid, rules, engine, whether the median splat is computed, which channels end in front, and the
            function that sums absolute gradients.
        means2d: `[M, 2]` pixels.
        conics: `[M, 3]`.
        opacities: `[M]`.
        features: `[M, D]` any channels.
        lists: `[capacity]` splats and `[num_tiles + 1]` offsets of `TilePairs`; or what `Engine.unlisted` returns.
        absgrad: `[M, 2]` anything, with `static.absolute`: nothing depends on it, and its gradient are those sums.
        probes: `[M, K]` channels of zeros, with `static.probes` K.

    Returns:
        `[C, H, W, D + K]` blended features on nothing and zeros, `[C, H, W, 1]` transmittance left, and `[C, H, W]`
        int32 the splat in which the light falls to one half (the last one that shows, where it does not; -1 for none),
        or None.
    """
    return _composite_fwd(static, means2d, conics, opacities, features, lists, absgrad, probes)[0]


def _composite_fwd(static, means2d, conics, opacities, features, lists, absgrad, probes):
    del absgrad, probes
    rows = jnp.concatenate([means2d, conics, opacities[:, None], features], axis=-1)
    blended = without_axes(partial(static.engine.forward, static), rows, lists)
    image = to_image(jnp.concatenate([blended.features, blended.transmittance[:, None]], 1), static.grid)
    median = None if blended.median is None else to_image(blended.median[:, None], static.grid)[..., 0]
    residuals = (rows, lists, blended.transmittance, blended.last), blended.residuals
    blended_features = jnp.pad(image[..., :-1], ((0, 0), (0, 0), (0, 0), (0, static.probes)))
    return (blended_features, image[..., -1:], median), residuals


def _composite_bwd(static, residuals, cotangents):
    of_all, of_engine = residuals
    d_tiles = to_tiles(jnp.concatenate(cotangents[:2], -1), static.grid)
    arguments = *of_all, d_tiles[:, :-1], d_tiles[:, -1]
    d_rows = without_axes(partial(static.engine.backward, static), *arguments, *of_engine)
    absolute = without_axes(partial(static.absolute, static), *arguments) if static.absolute else None
    width = of_all[0].shape[1]
    d_probes = d_rows[:, width:] if static.probes else None
    return d_rows[:, :2], d_rows[:, 2:5], d_rows[:, 5], d_rows[:, 6:width], None, absolute, d_probes


composite.defvjp(_composite_fwd, _composite_bwd)
