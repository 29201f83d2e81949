"""The tile engine as two GPU kernels (Pallas), launched by its Triton backend; `rasterizer._mosaic` has another launch.

The forward kernel has one program per tile, the deepest first. It walks the tile's list, one splat after the other: its
numbers are scalars for the whole program, its pixels a vector in registers. At every border of a *segment* of the list
it keeps the light left and what the segment's splats showed. From there the backward kernel starts: one program per
segment, so that no program walks a whole deep list back. It sums each pair's moments over the pixels and stores them;
no atomics. The blend is the text that the xla engine runs.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.experimental import pallas as pl

from rasterizer.blending import blend_splat, cut_alpha, front_weight, splat_sigma, unblend_splat
from rasterizer.compositing import (
    Blended,
    Engine,
    Static,
    chain_to_rows,
    moment_basis,
    pixel_centers,
    splats_at,
    tile_centers,
)
from rasterizer.tracing import result

CHUNK = 16  # Splats between two looks at whether every pixel has stopped: the look is a reduction over the program.
SEGMENT = 256  # Splats that one program of the backward pass walks.
FORWARD_WARPS = 2
BACKWARD_WARPS = 1  # Reductions within one warp need no barrier.


def _segments(offsets: Array, capacity: int, size: int) -> tuple[Array, Array]:
    """The lists cut in segments of at most `size` splats, which are numbered tile by tile.

    Returns:
        `[S]` the tile of every segment, the last tile's beyond the segments that there are, and `[T]` the first segment
        of every tile.
    """
    pieces = -(-(offsets[1:] - offsets[:-1]) // size)
    tiles = jnp.arange(pieces.shape[0], dtype=jnp.int32)
    most = pieces.shape[0] + capacity // size
    return jnp.repeat(tiles, pieces, total_repeat_length=most), jnp.cumsum(pieces, dtype=jnp.int32) - pieces


def _offsets(rows, splat, pixels, center) -> tuple[Array, Array]:
    """`[P]` x and y of the splat's mean relative to the pixels."""
    return (rows[splat, 0] - center[0]) - pixels[0], (rows[splat, 1] - center[1]) - pixels[1]


def _alpha(rows, splat, dx, dy, rules) -> tuple[Array, Array]:
    """`[P]` alpha before the clamp, and as blended."""
    sigma = splat_sigma(dx, dy, rows[splat, 2], rows[splat, 3], rows[splat, 4])
    unclamped = rows[splat, 5] * jnp.exp(-sigma)
    return unclamped, cut_alpha(unclamped, sigma, rules)


def _forward_kernel(
    program,
    rows,
    splats,
    offsets,
    order,
    first_segments,
    features,
    transmittance,
    last_index,
    kept_light,
    kept_features,
    *marks,
    static: Static,
    segment_size: int,
):
    tile = order[program]
    start, end, first_segment = offsets[tile], offsets[tile + 1], first_segments[tile]
    pixels, center = pixel_centers(static.grid, jnp.arange), tile_centers(tile, static.grid)
    channels, front = features.shape[1], static.front
    first_in_front = channels - (front.channels if front else 0)
    blank = jnp.zeros_like(pixels[0])
    nothing = jnp.full(blank.shape, -1, jnp.int32)

    def blend_one(k, state):
        signed_t, image, last, median, crossing = state
        splat = splats[k]
        _, alpha = _alpha(rows, splat, *_offsets(rows, splat, pixels, center), static.rules)
        weight, left = blend_splat(signed_t, alpha, static.rules)
        in_front = front_weight(signed_t, weight, front.stop_after) if front else weight
        weights = (weight,) * first_in_front + (in_front,) * (channels - first_in_front)
        image = tuple(c + w * rows[splat, 6 + i] for i, (c, w) in enumerate(zip(image, weights, strict=True)))
        last = jnp.where(weight > 0, k - start, last)
        if static.with_median:
            median = jnp.where((weight > 0) & (signed_t > 0.5), k - start, median)
        if front:
            crossing = jnp.where((in_front > 0) & (in_front < weight), k - start, crossing)
        return left, image, last, median, crossing

    def blend_segment(state):
        segment, signed_t, image, *indices = state
        begin = start + segment * segment_size
        stop = jnp.minimum(begin + segment_size, end)

        def blend_chunk(state):
            k, *pixel_state = state
            after = jnp.minimum(k + CHUNK, stop)
            return after, *jax.lax.fori_loop(k, after, blend_one, tuple(pixel_state))

        _, signed_t, segment_features, *indices = jax.lax.while_loop(
            lambda state: (state[0] < stop) & (jnp.max(state[1]) > 0),
            blend_chunk,
            (begin, signed_t, (blank,) * channels, *indices),
        )
        place = first_segment + segment
        kept_light[place, :] = jnp.abs(signed_t)
        for i in range(channels):
            kept_features[place, i, :] = segment_features[i]
        return segment + 1, signed_t, tuple(a + b for a, b in zip(image, segment_features, strict=True)), *indices

    state = jnp.int32(0), blank + 1, (blank,) * channels, nothing
    state = *state, nothing if static.with_median else None, nothing if front else None
    _, signed_t, image, last, *indices = jax.lax.while_loop(
        lambda state: (start + state[0] * segment_size < end) & (jnp.max(state[1]) > 0), blend_segment, state
    )
    for i in range(channels):
        features[tile, i, :] = image[i]
    transmittance[tile, :] = jnp.abs(signed_t)
    last_index[tile, :] = last
    for mark, index in zip(marks, [index for index in indices if index is not None], strict=True):
        mark[tile, :] = index


def _backward_kernel(
    segment,
    rows,
    splats,
    offsets,
    transmittance,
    last_index,
    d_features,
    d_transmittance,
    tiles,
    first_segments,
    kept_light,
    kept_features,
    *others,
    static: Static,
    segment_size: int,
):
    *crossings, gradients = others
    tile = tiles[segment]
    start, first_segment = offsets[tile], first_segments[tile]
    pixels, center = pixel_centers(static.grid, jnp.arange), tile_centers(tile, static.grid)
    last = last_index[tile, :]
    channels, front = d_features.shape[1] - static.probes, static.front
    first_in_front = channels - (front.channels if front else 0)
    count = jnp.max(last) + 1
    begin = (segment - first_segment) * segment_size
    stop = jnp.minimum(begin + segment_size, count)

    def lit_by(values, channel_range):
        return sum(values(c) * d_features[tile, c, :] for c in channel_range)

    def add_segment(behind, light):
        return light + lit_by(lambda c: kept_features[behind, c, :], range(channels))

    def unblend_one(i, state):
        t, behind = state
        k = stop - 1 - i
        splat = splats[start + k]
        dx, dy = _offsets(rows, splat, pixels, center)
        unclamped, alpha = _alpha(rows, splat, dx, dy, static.rules)
        alpha = jnp.where(k <= last, alpha, 0)
        lit = lit_by(lambda c: rows[splat, 6 + c], range(first_in_front))
        in_front = None
        if front:
            in_front = lit_by(lambda c: rows[splat, 6 + c], range(first_in_front, channels)), front.stop_after
        d_sigma, weight, t, behind = unblend_splat(t, behind, lit, alpha, unclamped, static.rules, in_front)
        for column, power in enumerate(moment_basis(dx, dy)):
            gradients[start + k, column] = jnp.sum(d_sigma * power)
        counted_in_front = front_weight(t, weight, front.stop_after) if front else weight
        for c in range(channels + static.probes):
            counted = counted_in_front if first_in_front <= c < channels else weight
            gradients[start + k, 6 + c] = jnp.sum(counted * d_features[tile, c, :])
        return t, behind

    segments_end = first_segment + (count + segment_size - 1) // segment_size
    light_behind = transmittance[tile, :] * d_transmittance[tile, :]
    light_behind = jax.lax.fori_loop(segment + 1, segments_end, add_segment, light_behind)
    if front:
        # Of the splat that uses the light up all of it counts (`unblend_splat`); the image has what is over stop_after.
        crossing = crossings[0][tile, :]
        is_behind = crossing >= stop
        splat = splats[jnp.where(is_behind, start + crossing, 0)]
        lit = lit_by(lambda c: rows[splat, 6 + c], range(first_in_front, channels))
        light_behind += jnp.where(is_behind, front.stop_after * lit, 0)
    jax.lax.fori_loop(0, stop - begin, unblend_one, (kept_light[segment, :], light_behind))


Launch = Callable[..., Any]
"""(kernel, programs, shapes, warps, interpret, arguments, zeros) -> what the programs of a kernel write.

A kernel is called with its program's number and the arrays, those that it writes last; where there are `zeros`, it
writes into these.
"""


def launch(
    kernel, programs: int, shapes, warps: int, interpret: bool, arguments: tuple[Array, ...], zeros: Array | None = None
):
    """A `Launch` by the Triton backend."""
    options: dict[str, Any] = {"out_shape": shapes, "interpret": interpret, "name": kernel.func.__name__}
    if not interpret:
        from jax.experimental.pallas import triton

        options["compiler_params"] = triton.CompilerParams(num_warps=warps, num_stages=1)
    if zeros is None:
        return pl.pallas_call(lambda *refs: kernel(pl.program_id(0), *refs), grid=(programs,), **options)(*arguments)
    count = len(arguments)
    return pl.pallas_call(
        lambda *refs: kernel(pl.program_id(0), *refs[:count], refs[-1]),
        grid=(programs,),
        input_output_aliases={count: 0},
        **options,
    )(*arguments, zeros)


def _forward(
    static: Static, rows: Array, lists: tuple[Array, Array], *, launch: Launch, interpret: bool, segment_size: int
) -> Blended:
    splats, offsets = lists
    tiles, pixels, channels = static.grid.num_tiles, static.grid.tile_size**2, rows.shape[1] - 6
    segments = _segments(offsets, splats.shape[0], segment_size)
    # A program that begins late and walks long would be the only one left at the end.
    order = jnp.argsort(offsets[:-1] - offsets[1:]).astype(jnp.int32)
    many = segments[0].shape[0]
    indices = result((tiles, pixels), jnp.int32)
    shapes = [
        result((tiles, channels, pixels), jnp.float32),
        result((tiles, pixels), jnp.float32),
        indices,
        result((many, pixels), jnp.float32),
        result((many, channels, pixels), jnp.float32),
        *[indices] * (static.with_median + bool(static.front)),
    ]
    kernel = partial(_forward_kernel, static=static, segment_size=segment_size)
    arguments = rows, splats, offsets, order, segments[1]
    features, t, last, light, segment_features, *marks = launch(
        kernel, tiles, shapes, FORWARD_WARPS, interpret, arguments
    )
    median, crossings = None, marks
    if static.with_median:
        median, crossings = splats_at(marks[0], splats, offsets), marks[1:]
    return Blended(features, t, last, median, (*segments, light, segment_features, *crossings))


def _backward(
    static: Static,
    rows: Array,
    lists: tuple[Array, Array],
    t: Array,
    last: Array,
    d_features: Array,
    d_t: Array,
    *residuals: Array,
    launch: Launch,
    interpret: bool,
    segment_size: int,
    sum_rows: Callable[[Array, Array, int], Array],
) -> Array:
    splats, offsets = lists
    # The kernel writes the pairs that a pixel shows; the others keep their zeros.
    zeros = jnp.zeros((splats.shape[0], rows.shape[1] + static.probes), jnp.float32)
    arguments = rows, splats, offsets, t, last, d_features, d_t, *residuals
    kernel = partial(_backward_kernel, static=static, segment_size=segment_size)
    shape = result(zeros.shape, zeros.dtype)
    gradients = launch(kernel, residuals[0].shape[0], shape, BACKWARD_WARPS, interpret, arguments, zeros)
    d_rows = chain_to_rows(rows[splats], gradients[:, :6], gradients[:, 6:])
    # A GPU adds by atomics, and zeros of a whole buffer to one row wait for each other: their index is past all rows.
    has_gradient = jnp.any(gradients != 0, -1)
    return sum_rows(d_rows, jnp.where(has_gradient, splats, rows.shape[0]), rows.shape[0])


def atomic_sums(values: Array, places: Array, count: int) -> Array:
    """`[count, W]` sums of the rows `[P, W]` of each place `[P]`; one past the last is left out. Atomics on a GPU."""
    return jnp.zeros((count, values.shape[1]), values.dtype).at[places].add(values, mode="drop")


def sorted_sums(values: Array, places: Array, count: int) -> Array:
    """`atomic_sums` in an order that is always the same: rows are sorted by place and summed as one tree of pairs."""
    rows = jnp.arange(places.shape[0], dtype=jnp.int32)
    places, order = jax.lax.sort((places, rows), num_keys=1, is_stable=True)
    begins = places[1:] != places[:-1]
    edge = jnp.ones(1, bool)

    def add(left, right):
        (left_begins, left_sum), (right_begins, right_sum) = left, right
        return left_begins | right_begins, jnp.where(right_begins[:, None], right_sum, left_sum + right_sum)

    _, sums = jax.lax.associative_scan(add, (jnp.concatenate([edge, begins]), values[order]))
    last = jnp.concatenate([begins, edge])
    zeros = jnp.zeros((count, values.shape[1]), values.dtype)
    return zeros.at[jnp.where(last, places, count)].set(sums, mode="drop")


@cache
def engine(
    interpret: bool,
    segment_size: int = SEGMENT,
    launch: Launch = launch,
    sum_rows: Callable[[Array, Array, int], Array] = atomic_sums,
) -> Engine:
    """The kernels, or, without a GPU, their interpretation: as slow as it is faithful.

    `sum_rows` adds the pairs' gradients up: `atomic_sums`, or `sorted_sums` for the same bits in every run.
    """
    how = {"launch": launch, "interpret": interpret, "segment_size": segment_size}
    forward, backward = partial(_forward, **how), partial(_backward, **how, sum_rows=sum_rows)
    return Engine(forward, backward, tile_size=16, check_side=_check_side)


def _check_side(side: int) -> None:
    if side & (side - 1):
        raise ValueError(f"tile_size={side} is not a power of two, as backend='pallas' needs it")
