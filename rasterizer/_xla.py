"""The tile rasterizer in jnp: the CPU path, and the fallback everywhere. Forward and backward by hand.

Tiles run in groups of lanes, sorted by list length, in lockstep through a `while_loop` over the list index: nothing is
padded beyond a group's own longest list, a group stops when all its pixels are opaque, and the vectors are long enough
for XLA to use every core. The backward pass walks the same lists from the last contributing splat to the first,
recovers transmittance by division, and reduces over a tile's pixels by one product with the basis
1, x, y, x^2, xy, y^2 (moments); the chain rule to mean and conic is applied once per pair, outside the loop.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from rasterizer.binning import TileGrid
from rasterizer.blending import cut_alpha, splat_sigma
from rasterizer.rules import Rules

LANES = 256  # Tiles that run in lockstep: long vectors against early exit. 256-512 measured best on 2 cores.
UNROLL = 4  # Splats per forward iteration.


class Static(NamedTuple):
    """What a compiled compositor is specialised on."""

    grid: TileGrid
    rules: Rules


def _pixel_centers(grid: TileGrid) -> tuple[Array, Array]:
    """`[P]` x and y of a tile's pixel centres, relative to the tile's centre (small numbers round less)."""
    y, x = np.mgrid[0 : grid.tile_size, 0 : grid.tile_size] + 0.5 - grid.tile_size / 2
    return jnp.asarray(x.ravel(), jnp.float32), jnp.asarray(y.ravel(), jnp.float32)


def _tile_centers(tiles: Array, grid: TileGrid) -> Array:
    """`[..., 2]` image position of the tiles' centres, pixels."""
    within = tiles % (grid.tiles_x * grid.tiles_y)
    corner = jnp.stack([within % grid.tiles_x, within // grid.tiles_x], -1) * grid.tile_size
    return corner.astype(jnp.float32) + grid.tile_size / 2


def _groups(counts: Array) -> Array:
    """`[groups, lanes]` tiles by falling list length; missing ones are numbered num_tiles (an empty list)."""
    num_tiles = counts.shape[0]
    lanes = min(LANES, num_tiles)
    order = jnp.argsort(-counts).astype(jnp.int32)
    missing = -num_tiles % lanes
    return jnp.concatenate([order, jnp.full(missing, num_tiles, jnp.int32)]).reshape(-1, lanes)


def _with_empty_tile(x: Array) -> Array:
    return jnp.concatenate([x, jnp.zeros((1, *x.shape[1:]), x.dtype)])


def _to_tiles(image: Array, grid: TileGrid) -> Array:
    """`[C, H, W, D]` -> `[num_tiles, D, P]`, zero beyond the image border."""
    size, channels = grid.tile_size, image.shape[-1]
    pad_y, pad_x = grid.tiles_y * size - grid.height, grid.tiles_x * size - grid.width
    padded = jnp.pad(image, ((0, 0), (0, pad_y), (0, pad_x), (0, 0)))
    blocks = padded.reshape(grid.num_cameras, grid.tiles_y, size, grid.tiles_x, size, channels)
    return blocks.transpose(0, 1, 3, 5, 2, 4).reshape(grid.num_tiles, channels, size * size)


def _to_image(tiles: Array, grid: TileGrid) -> Array:
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


def _forward(static: Static, rows: Array, splats: Array, offsets: Array):
    """-> features [T, D, P], transmittance [T, P], last contributing list index [T, P]."""
    grid, rules = static
    pixel_x, pixel_y = _pixel_centers(grid)
    counts = offsets[1:] - offsets[:-1]
    all_counts, all_starts = _with_empty_tile(counts), _with_empty_tile(offsets[:-1])
    pairs = rows[splats]
    channels = rows.shape[1] - 6

    def group(tiles: Array):
        start, count, center = all_starts[tiles], all_counts[tiles], _tile_centers(tiles, grid)

        def body(state):
            k, signed_t, out, last = state
            block = pairs[start[:, None] + jnp.arange(UNROLL, dtype=jnp.int32) + k]
            for u in range(UNROLL):
                row = block[:, u]
                dx = (row[:, 0] - center[:, 0])[:, None] - pixel_x
                dy = (row[:, 1] - center[:, 1])[:, None] - pixel_y
                sigma = splat_sigma(dx, dy, row[:, 2:3], row[:, 3:4], row[:, 4:5])
                opacity = jnp.where(k + u < count, row[:, 5], 0)
                alpha = cut_alpha(opacity[:, None] * jnp.exp(-sigma), sigma, rules)
                # The sign of the transmittance says whether the pixel has stopped: no flag array is carried.
                left = signed_t * (1 - alpha)
                live = left > rules.transmittance_min
                weight = jnp.where(live, signed_t - left, 0)
                out = [c + weight * row[:, 6 + i : 7 + i] for i, c in enumerate(out)]
                last = jnp.where(weight > 0, k + u, last)
                signed_t = jnp.where(live, left, -jnp.abs(signed_t))
            return k + UNROLL, signed_t, out, last

        def unfinished(state):
            k, signed_t, _, _ = state
            return (k < count.max()) & (signed_t.max() > 0)

        blank = jnp.zeros((tiles.shape[0], pixel_x.shape[0]), jnp.float32)
        state = (jnp.int32(0), blank + 1, [blank] * channels, jnp.full(blank.shape, -1, jnp.int32))
        _, signed_t, out, last = jax.lax.while_loop(unfinished, body, state)
        return jnp.stack(out, 1), jnp.abs(signed_t), last

    groups = _groups(counts)
    done = jax.lax.map(group, groups)
    place = (
        jnp.zeros(groups.size, jnp.int32)
        .at[groups.reshape(-1)]
        .set(jnp.arange(groups.size, dtype=jnp.int32), mode="drop")[: counts.shape[0]]
    )
    return tuple(x.reshape(-1, *x.shape[2:])[place] for x in done)


def _backward(static: Static, rows: Array, splats: Array, offsets: Array, final_t, last, d_features, d_final_t):
    """-> `[capacity, 6 + D]` per pair: moments of dL/dsigma over 1, x, y, xx, xy, yy and dL/dfeatures."""
    grid, rules = static
    pixel_x, pixel_y = _pixel_centers(grid)
    basis = jnp.stack(
        [jnp.ones_like(pixel_x), pixel_x, pixel_y, pixel_x * pixel_x, pixel_x * pixel_y, pixel_y * pixel_y], -1
    )
    counts = jnp.minimum(offsets[1:] - offsets[:-1], last.max(-1) + 1)
    all_counts, all_starts = _with_empty_tile(counts), _with_empty_tile(offsets[:-1])
    all_t, all_last, all_df, all_dt = (_with_empty_tile(x) for x in (final_t, last, d_features, d_final_t))
    pairs = rows[splats]
    capacity, channels = splats.shape[0], rows.shape[1] - 6

    def group(gradients: Array, tiles: Array):
        start, count, center = all_starts[tiles], all_counts[tiles], _tile_centers(tiles, grid)
        d_feature, last_index = all_df[tiles], all_last[tiles]

        def body(state):
            k, t, behind, gradients = state
            live = k < count
            row = pairs[start + k]
            dx = (row[:, 0] - center[:, 0])[:, None] - pixel_x
            dy = (row[:, 1] - center[:, 1])[:, None] - pixel_y
            sigma = splat_sigma(dx, dy, row[:, 2:3], row[:, 3:4], row[:, 4:5])
            unclamped = jnp.where(live, row[:, 5], 0)[:, None] * jnp.exp(-sigma)
            alpha = jnp.where(k <= last_index, cut_alpha(unclamped, sigma, rules), 0)
            inverse = 1 / (1 - alpha)
            t = t * inverse
            weight = t * alpha
            lit = sum(row[:, 6 + i : 7 + i] * d_feature[:, i] for i in range(channels))
            # dL/dalpha = T lit - (what lies behind) / (1 - alpha); d alpha / d sigma = -unclamped alpha.
            differentiable = alpha > 0 if rules.straight_through else (alpha > 0) & (unclamped < rules.alpha_max)
            d_sigma = jnp.where(differentiable, (behind * inverse - t * lit) * unclamped, 0)
            moments = jnp.dot(d_sigma, basis, precision=jax.lax.Precision.HIGHEST)
            # A batched product: XLA's CPU row sums are a quarter of the whole backward pass otherwise.
            d_row = jnp.einsum("gp,gcp->gc", weight, d_feature, precision=jax.lax.Precision.HIGHEST)
            gradients = gradients.at[jnp.where(live, start + k, capacity)].set(
                jnp.concatenate([moments, d_row], -1), mode="drop"
            )
            return k - 1, t, behind + weight * lit, gradients

        state = (count.max() - 1, all_t[tiles], all_t[tiles] * all_dt[tiles], gradients)
        return jax.lax.while_loop(lambda s: s[0] >= 0, body, state)[3], None

    return jax.lax.scan(group, jnp.zeros((capacity, 6 + channels), jnp.float32), _groups(counts))[0]


def _chain_to_splats(static: Static, rows: Array, splats: Array, offsets: Array, gradients: Array) -> Array:
    """`[M, 6 + D]` gradient to the splat rows from the moments of every pair."""
    grid, _ = static
    slot = jnp.arange(splats.shape[0], dtype=jnp.int32)
    starts = jnp.zeros(splats.shape[0] + 1, jnp.int32).at[offsets[1:]].add(1)
    tile = jnp.minimum(jnp.cumsum(starts)[:-1], grid.num_tiles - 1)
    center, row = _tile_centers(tile, grid), rows[splats]
    x, y, xx, xy, yy = row[:, 0] - center[:, 0], row[:, 1] - center[:, 1], row[:, 2], row[:, 3], row[:, 4]
    m1, mx, my, mxx, mxy, myy = (gradients[:, i] for i in range(6))
    # Sums of dL/dsigma times powers of the offset d = mean - pixel.
    dx, dy = x * m1 - mx, y * m1 - my
    dxx, dyy = x * (x * m1 - 2 * mx) + mxx, y * (y * m1 - 2 * my) + myy
    dxy = x * y * m1 - x * my - y * mx + mxy
    opacity = jnp.where(row[:, 5] > 0, row[:, 5], 1)
    d_row = jnp.stack([xx * dx + xy * dy, xy * dx + yy * dy, 0.5 * dxx, dxy, 0.5 * dyy, -m1 / opacity], -1)
    d_row = jnp.where((slot < offsets[-1])[:, None], jnp.concatenate([d_row, gradients[:, 6:]], -1), 0)
    return jnp.zeros_like(rows).at[splats].add(d_row)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def composite(static: Static, means2d: Array, conics: Array, opacities: Array, features: Array, splats, offsets):
    """Blend the listed splats front to back.

    Args:
        static: Tile grid and rules.
        means2d: `[M, 2]` pixels.
        conics: `[M, 3]`.
        opacities: `[M]`.
        features: `[M, D]` any channels.
        splats: `[capacity]` sorted pairs from `binning`.
        offsets: `[num_tiles + 1]`.

    Returns:
        `[C, H, W, D]` blended features on nothing, and `[C, H, W, 1]` transmittance left.
    """
    return _composite_fwd(static, means2d, conics, opacities, features, splats, offsets)[0]


def _composite_fwd(static, means2d, conics, opacities, features, splats, offsets):
    rows = _splat_rows(means2d, conics, opacities, features)
    blended, t, last = _forward(static, rows, splats, offsets)
    image = _to_image(jnp.concatenate([blended, t[:, None]], 1), static.grid)
    return (image[..., :-1], image[..., -1:]), (rows, splats, offsets, t, last)


def _composite_bwd(static, residuals, cotangents):
    rows, splats, offsets, t, last = residuals
    d_tiles = _to_tiles(jnp.concatenate(cotangents, -1), static.grid)
    gradients = _backward(static, rows, splats, offsets, t, last, d_tiles[:, :-1], d_tiles[:, -1])
    d_rows = _chain_to_splats(static, rows, splats, offsets, gradients)
    return d_rows[:, :2], d_rows[:, 2:5], d_rows[:, 5], d_rows[:, 6:], None, None


composite.defvjp(_composite_fwd, _composite_bwd)
