"""The tile engine in jnp: the CPU path, and the fallback everywhere. Forward and backward by hand.

Tiles run in groups of lanes, sorted by list length, in lockstep through a `while_loop` over the list index: nothing is
padded beyond a group's own longest list, a group stops when all its pixels are opaque, and the vectors are long enough
for XLA to use every core. The backward pass walks the same lists from the last contributing splat to the first,
recovers transmittance by division, and reduces over a tile's pixels by one product with the basis
1, x, y, x^2, xy, y^2 (moments).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from rasterizer.blending import blend_splat, cut_alpha, front_weight, splat_sigma, unblend_splat
from rasterizer.compositing import (
    Blended,
    Engine,
    Static,
    chain_to_rows,
    moment_basis,
    moments_about_means,
    pixel_centers,
    splats_at,
    tile_centers,
)

LANES = 256  # Tiles that run in lockstep: long vectors against early exit. 256-512 measured best on 2 cores.
UNROLL = 4  # Splats per forward iteration.


def _groups(counts: Array) -> Array:
    """`[groups, lanes]` tiles by falling list length; missing ones are numbered num_tiles (an empty list)."""
    num_tiles = counts.shape[0]
    lanes = min(LANES, num_tiles)
    order = jnp.argsort(-counts).astype(jnp.int32)
    missing = -num_tiles % lanes
    return jnp.concatenate([order, jnp.full(missing, num_tiles, jnp.int32)]).reshape(-1, lanes)


def _with_empty_tile(x: Array) -> Array:
    return jnp.concatenate([x, jnp.zeros((1, *x.shape[1:]), x.dtype)])


def _forward(static: Static, rows: Array, lists: tuple[Array, Array]) -> Blended:
    splats, offsets = lists
    pixel_x, pixel_y = pixel_centers(static.grid)
    counts = offsets[1:] - offsets[:-1]
    all_counts, all_starts = _with_empty_tile(counts), _with_empty_tile(offsets[:-1])
    channels, front = rows.shape[1] - 6, static.front
    first_in_front = channels - (front.channels if front else 0)

    def group(tiles: Array):
        start, count, center = all_starts[tiles], all_counts[tiles], tile_centers(tiles, static.grid)

        def body(state):
            k, signed_t, out, last, median = state
            block = rows[splats[start[:, None] + (jnp.arange(UNROLL, dtype=jnp.int32) + k)[None]]]
            for u in range(UNROLL):
                row = block[:, u]
                dx = (row[:, 0] - center[0])[:, None] - pixel_x[None]
                dy = (row[:, 1] - center[1])[:, None] - pixel_y[None]
                sigma = splat_sigma(dx, dy, row[:, 2:3], row[:, 3:4], row[:, 4:5])
                opacity = jnp.where(k + u < count, row[:, 5], 0)
                alpha = cut_alpha(opacity[:, None] * jnp.exp(-sigma), sigma, static.rules)
                before = signed_t
                weight, signed_t = blend_splat(before, alpha, static.rules)
                in_front = front_weight(before, weight, front.stop_after) if front else weight
                weights = [weight] * first_in_front + [in_front] * (channels - first_in_front)
                out = [c + w * row[:, 6 + i : 7 + i] for i, (c, w) in enumerate(zip(out, weights, strict=True))]
                last = jnp.where(weight > 0, k + u, last)
                if median is not None:
                    median = jnp.where((weight > 0) & (before > 0.5), k + u, median)
            return k + UNROLL, signed_t, out, last, median

        def unfinished(state):
            k, signed_t, *_ = state
            return (k < count.max()) & (signed_t.max() > 0)

        blank = jnp.zeros((tiles.shape[0], pixel_x.shape[0]), jnp.float32)
        nothing = jnp.full(blank.shape, -1, jnp.int32)
        state = (jnp.int32(0), blank + 1, [blank] * channels, nothing, nothing if static.with_median else None)
        _, signed_t, out, last, median = jax.lax.while_loop(unfinished, body, state)
        return Blended(jnp.stack(out, 1), jnp.abs(signed_t), last, median)

    groups = _groups(counts)
    done = jax.lax.map(group, groups)
    place = jnp.argsort(groups.reshape(-1))[: counts.shape[0]]  # Missing tiles are numbered last.
    blended = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[place], done)
    if blended.median is None:
        return blended
    return blended._replace(median=splats_at(blended.median, splats, offsets))


class _Pairs(NamedTuple):
    """One splat of each of g tiles, at P pixels, on the way back."""

    row: Array  # [g, 6 + D]
    center: tuple[Array, Array]  # [g] x and y of the tile's, pixels
    dx: Array  # [g, P] mean - pixel
    dy: Array
    d_sigma: Array  # [g, P] dL/dsigma
    weight: Array  # [g, P]
    t: Array  # [g, P] transmittance in front of it
    d_feature: Array  # [g, c, P] dL/dimage of the channels that go on
    d_front: Array  # [g, c, P] of those that end in front
    d_probe: Array  # [g, c, P] of the probes


def _sum_over_pairs(
    of_pairs: Callable[[_Pairs], Array],
    width: int,
    static: Static,
    rows: Array,
    lists: tuple[Array, Array],
    final_t: Array,
    last: Array,
    d_features: Array,
    d_final_t: Array,
) -> Array:
    """`[M, width]` sums over each splat's pairs of `of_pairs`, `[g, width]`, back to front."""
    splats, offsets = lists
    pixel_x, pixel_y = pixel_centers(static.grid)
    counts = jnp.minimum(offsets[1:] - offsets[:-1], last.max(-1) + 1)
    all_counts, all_starts = _with_empty_tile(counts), _with_empty_tile(offsets[:-1])
    all_t, all_last, all_df, all_dt = map(_with_empty_tile, (final_t, last, d_features, d_final_t))
    channels, front = rows.shape[1] - 6, static.front
    first_in_front = channels - (front.channels if front else 0)

    def group(sums: Array, tiles: Array):
        start, count, center = all_starts[tiles], all_counts[tiles], tile_centers(tiles, static.grid)
        last_index = all_last[tiles]
        d_feature, d_front, d_probe = jnp.split(all_df[tiles], [first_in_front, channels], 1)

        def body(state):
            k, t, behind, sums = state
            live = k < count
            splat = splats[start + k]
            row = rows[splat]
            dx = (row[:, 0] - center[0])[:, None] - pixel_x[None]
            dy = (row[:, 1] - center[1])[:, None] - pixel_y[None]
            sigma = splat_sigma(dx, dy, row[:, 2:3], row[:, 3:4], row[:, 4:5])
            unclamped = jnp.where(live, row[:, 5], 0)[:, None] * jnp.exp(-sigma)
            alpha = jnp.where(k <= last_index, cut_alpha(unclamped, sigma, static.rules), 0)
            lit = sum(row[:, 6 + i : 7 + i] * d_feature[:, i] for i in range(first_in_front))
            in_front = None
            if front:
                lit_in_front = sum(row[:, 6 + first_in_front + i, None] * d_front[:, i] for i in range(front.channels))
                in_front = lit_in_front, front.stop_after
            d_sigma, weight, t, behind = unblend_splat(t, behind, lit, alpha, unclamped, static.rules, in_front)
            of_each = of_pairs(_Pairs(row, center, dx, dy, d_sigma, weight, t, d_feature, d_front, d_probe))
            sums = sums.at[jnp.where(live, splat, rows.shape[0])].add(of_each, mode="drop")
            return k - 1, t, behind, sums

        state = (count.max() - 1, all_t[tiles], all_t[tiles] * all_dt[tiles], sums)
        return jax.lax.while_loop(lambda s: s[0] >= 0, body, state)[3], None

    return jax.lax.scan(group, jnp.zeros((rows.shape[0], width), rows.dtype), _groups(counts))[0]


def _backward(static: Static, rows: Array, *others: Any) -> Array:
    basis = jnp.stack(moment_basis(*pixel_centers(static.grid)), -1)
    front = static.front

    def gradient(pairs: _Pairs) -> Array:
        moments = jnp.dot(pairs.d_sigma, basis, precision=jax.lax.Precision.HIGHEST)
        d_pair = _summed(pairs.weight, pairs.d_feature)
        if front:
            counted = front_weight(pairs.t, pairs.weight, front.stop_after)
            d_pair = jnp.concatenate([d_pair, _summed(counted, pairs.d_front)], 1)
        if static.probes:
            d_pair = jnp.concatenate([d_pair, _summed(pairs.weight, pairs.d_probe)], 1)
        return chain_to_rows(pairs.row, moments_about_means(pairs.row, pairs.center, moments), d_pair)

    return _sum_over_pairs(gradient, rows.shape[1] + static.probes, static, rows, *others)


def absolute_gradients(static: Static, rows: Array, *others: Any) -> Array:
    """`[M, 2]` absolute gradients to the splats' means, summed over pixels (AbsGS); arguments as of `Engine.backward`.

    It serves all engines, since it reads no residuals of an engine's own.
    """

    def absolute(pairs: _Pairs) -> Array:
        xx, xy, yy = (pairs.row[:, i, None] for i in (2, 3, 4))
        slopes = xx * pairs.dx + xy * pairs.dy, xy * pairs.dx + yy * pairs.dy
        return jnp.stack([jnp.sum(jnp.abs(pairs.d_sigma * slope), -1) for slope in slopes], -1)

    return _sum_over_pairs(absolute, 2, static, rows, *others)


def _summed(weights: Array, d_features: Array) -> Array:
    """`[g, c]` sums over the pixels of `[g, p]` times `[g, c, p]`."""
    # A batched product: XLA's CPU row sums are a quarter of the whole backward pass otherwise.
    return jnp.einsum("gp,gcp->gc", weights, d_features, precision=jax.lax.Precision.HIGHEST)


ENGINE = Engine(_forward, _backward)
