"""Compositing of listed splats: one `custom_vjp` around whichever engine blends the tiles.

An engine is two functions, forward and backward over tiles; the layout and the chain rule from a tile's moments to
means and conics, applied once per (tile, splat) pair, are the same for all and live here.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from rasterizer.binning import TileGrid, TilePairs, bin_splats
from rasterizer.covariances import components
from rasterizer.manual_axes import without_axes
from rasterizer.rules import Rules


class Front(NamedTuple):
    """Channels that end with the first layers, while the others go on. Hashable, static.

    They see the light down to a transmittance of `stop_after`: the splat that would leave less counts with what is
    missing to that, nothing behind it counts. Weights are continuous in all alphas.
    """

    channels: int  # the last so many
    stop_after: float


class Blended(NamedTuple):
    """What an engine's forward pass leaves of T tiles of P pixels. Indices count along a tile's own list."""

    features: Array  # [T, D, P]
    transmittance: Array  # [T, P]
    last: Array  # [T, P] int32 last contributing splat, -1 for none
    median: Array | None  # [T, P] int32 last contributing splat with more than half the light left in front of it
    kept: tuple[Array, ...] = ()  # what the engine's own backward pass reads besides


class Unlisted(NamedTuple):
    """The two passes of an engine that lists splats in memory of its own: no caller chooses a capacity."""

    # (projection, opacities, grid, rules, masks) -> arrays that the lists are made of, without gradient
    listed: Callable[..., tuple[Array, ...]]
    # (static, rows, listed) -> Blended, whose median is a splat
    forward: Callable[..., Blended]
    # (static, rows, listed, transmittance, last, d_features, d_transmittance) -> [M, 6 + D], dL/drows
    backward: Callable[..., Array]


class Engine(NamedTuple):
    """The two passes over tiles, and what lists their splats. Hashable, static."""

    # (static, rows, splats, offsets) -> Blended. rows [M, 6 + D] of `_splat_rows`; lists of `binning.TilePairs`.
    forward: Callable[..., Blended]
    # (static, rows, splats, offsets, transmittance, last, d_features, d_transmittance, *kept) -> [M, 6 + D], dL/drows.
    backward: Callable[..., Array]
    lists: Callable[..., TilePairs] = bin_splats
    unlisted: Unlisted | None = None


class Static(NamedTuple):
    """What a compiled compositor is specialised on."""

    grid: TileGrid
    rules: Rules
    engine: Engine
    with_median: bool = False
    front: Front | None = None
    # (static, rows, ..., d_transmittance) -> [M, 2] absolute gradients to means, summed over pixels; None: not wanted
    absolute: Callable[..., Array] | None = None


def pixel_centers(grid: TileGrid) -> tuple[Array, Array]:
    """`[P]` x and y of a tile's pixel centres, relative to the tile's centre (small numbers round less)."""
    y, x = np.mgrid[0 : grid.tile_size, 0 : grid.tile_size] + 0.5 - grid.tile_size / 2
    return jnp.asarray(x.ravel(), jnp.float32), jnp.asarray(y.ravel(), jnp.float32)


def moment_basis(x: Array, y: Array) -> list[Array]:
    """What dL/dsigma is summed against: the chain rule to a splat's mean and conic needs no more."""
    return [jnp.ones_like(x), x, y, x * x, x * y, y * y]


def tile_centers(tiles: Array, grid: TileGrid) -> Array:
    """`[..., 2]` image position of the tiles' centres, pixels."""
    within = tiles % (grid.tiles_x * grid.tiles_y)
    corner = jnp.stack([within % grid.tiles_x, within // grid.tiles_x], -1) * grid.tile_size
    return corner.astype(jnp.float32) + grid.tile_size / 2


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


def _splat_rows(means2d: Array, conics: Array, opacities: Array, features: Array) -> Array:
    """`[M, 6 + D]`: x, y, conic xx xy yy, opacity, features: one gather per pair fetches all."""
    return jnp.concatenate([means2d, conics, opacities[:, None], features], axis=-1)


def moments_about_means(rows: Array, centers: Array, moments: Array) -> Array:
    """`[..., 6]` moments of dL/dsigma over a tile's pixels, moved from the tile's centre to the splat's mean.

    Args:
        rows: `[..., 6 + D]` splats.
        centers: `[..., 2]` centre of the tile that summed, pixels.
        moments: `[..., 6]` dL/dsigma summed against `moment_basis` of the pixels relative to the tile's centre.

    Returns:
        The same sums against `moment_basis` of the offsets d = mean - pixel. A splat that shows far nearer to its mean
        than to the tile's centre loses digits of the second ones, as the square of that ratio.
    """
    x, y = rows[..., 0] - centers[..., 0], rows[..., 1] - centers[..., 1]
    m1, mx, my, mxx, mxy, myy = components(moments)
    dxx, dyy = x * (x * m1 - 2 * mx) + mxx, y * (y * m1 - 2 * my) + myy
    return jnp.stack([m1, x * m1 - mx, y * m1 - my, dxx, x * y * m1 - x * my - y * mx + mxy, dyy], -1)


def chain_to_rows(rows: Array, moments: Array, d_features: Array) -> Array:
    """`[..., 6 + D]` gradients to splat rows.

    Args:
        rows: `[..., 6 + D]` splats.
        moments: `[..., 6]` dL/dsigma summed against `moment_basis` of the offsets mean - pixel.
        d_features: `[..., D]` dL/dfeatures.
    """
    xx, xy, yy = components(rows[..., 2:5])
    d1, dx, dy, dxx, dxy, dyy = components(moments)
    opacity = jnp.where(rows[..., 5] > 0, rows[..., 5], 1)
    shape = jnp.stack([xx * dx + xy * dy, xy * dx + yy * dy, 0.5 * dxx, dxy, 0.5 * dyy, -d1 / opacity], -1)
    return jnp.concatenate([shape, d_features], -1)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def composite(
    static: Static,
    means2d: Array,
    conics: Array,
    opacities: Array,
    features: Array,
    splats: Array,
    offsets: Array,
    absgrad: Array | None = None,
):
    """Blend the listed splats front to back.

    Args:
        static: Tile grid, rules, engine, whether the median splat is wanted, which channels end in front, and what
            sums absolute gradients.
        means2d: `[M, 2]` pixels.
        conics: `[M, 3]`.
        opacities: `[M]`.
        features: `[M, D]` any channels.
        splats: `[capacity]` sorted pairs from `binning`.
        offsets: `[num_tiles + 1]`.
        absgrad: `[M, 2]` anything, with `static.absolute`: nothing depends on it, and its gradient are those sums.

    Returns:
        `[C, H, W, D]` blended features on nothing, `[C, H, W, 1]` transmittance left, and `[C, H, W]` int32 the splat
        in which the light falls to one half (the last one that shows, where it does not; -1 for none), or None.
    """
    return _composite_fwd(static, means2d, conics, opacities, features, splats, offsets, absgrad)[0]


def _composite_fwd(static, means2d, conics, opacities, features, splats, offsets, absgrad):
    del absgrad
    rows = _splat_rows(means2d, conics, opacities, features)
    blended = without_axes(partial(static.engine.forward, static), rows, splats, offsets)
    image = to_image(jnp.concatenate([blended.features, blended.transmittance[:, None]], 1), static.grid)
    median = None
    if blended.median is not None:
        listed = splats[offsets[:-1, None] + jnp.maximum(blended.median, 0)]
        median = to_image(jnp.where(blended.median >= 0, listed, -1)[:, None], static.grid)[..., 0]
    residuals = rows, splats, offsets, blended.transmittance, blended.last, blended.kept
    return (image[..., :-1], image[..., -1:], median), residuals


def _composite_bwd(static, residuals, cotangents):
    rows, splats, offsets, t, last, kept = residuals
    d_tiles = to_tiles(jnp.concatenate(cotangents[:2], -1), static.grid)
    d_image = d_tiles[:, :-1], d_tiles[:, -1]
    arguments = rows, splats, offsets, t, last, *d_image
    d_rows = without_axes(partial(static.engine.backward, static), *arguments, *kept)
    absolute = without_axes(partial(static.absolute, static), *arguments) if static.absolute else None
    return d_rows[:, :2], d_rows[:, 2:5], d_rows[:, 5], d_rows[:, 6:], None, None, absolute


composite.defvjp(_composite_fwd, _composite_bwd)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def composite_unlisted(
    static: Static, means2d: Array, conics: Array, opacities: Array, features: Array, listed: tuple[Array, ...]
):
    """`composite` by an engine that lists the splats itself, of `listed` as its `Unlisted.listed` returns it."""
    return _unlisted_fwd(static, means2d, conics, opacities, features, listed)[0]


def _unlisted_fwd(static, means2d, conics, opacities, features, listed):
    rows = _splat_rows(means2d, conics, opacities, features)
    blended = without_axes(partial(static.engine.unlisted.forward, static), rows, listed)
    image = to_image(jnp.concatenate([blended.features, blended.transmittance[:, None]], 1), static.grid)
    median = None if blended.median is None else to_image(blended.median[:, None], static.grid)[..., 0]
    return (image[..., :-1], image[..., -1:], median), (rows, listed, blended.transmittance, blended.last)


def _unlisted_bwd(static, residuals, cotangents):
    d_tiles = to_tiles(jnp.concatenate(cotangents[:2], -1), static.grid)
    d_rows = without_axes(partial(static.engine.unlisted.backward, static), *residuals, d_tiles[:, :-1], d_tiles[:, -1])
    return d_rows[:, :2], d_rows[:, 2:5], d_rows[:, 5], d_rows[:, 6:], None


composite_unlisted.defvjp(_unlisted_fwd, _unlisted_bwd)
