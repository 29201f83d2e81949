"""The two passes over an image, as XLA calls them: tiles in bands, a band a thread's work.

A band copies the rows of the splats that it meets, in the order in which it meets them, so that a tile's splats lie
close together. On the way back it sums into rows of its own; these are added band by band, so that the bits of a
gradient do not depend on who did what when.
"""

import numpy as np

from rasterizer._native.blending import HALF, ONE, ZERO, Thresholds
from rasterizer._native.calls import (
    HANDLER,
    TASK,
    allocate,
    argument,
    floats,
    int32s,
    item_after,
    job_of,
    length,
    let_go,
    next_item,
    no_memory,
    only_introduces,
    release,
    result,
    set_word,
    share,
    word,
)
from rasterizer._native.compiled import entry_point, inlined
from rasterizer._native.instructions import (
    address_of,
    as_floats,
    as_int32s,
    define,
    floats_at,
    int32s_at,
    prefetch,
    words_on_stack,
)
from rasterizer._native.tiles import (
    CHANNELS,
    GEOMETRY,
    REACH,
    at_least_three,
    blend_tile,
    reach_along_y,
    unblend_tile,
)

BANDS = 6  # How many are best depends little on the scene; no more threads than these share a pass.
AHEAD = 16  # splats: memory answers about so many later
CHUNKS = 16  # Of rows, whose gradients are added together.
# Of a job: its frame, whether memory was lacking, then two words a band: where its splats' sums are, and these.
_FRAME, _LACKED, _BANDS, _JOB_WORDS = 0, 1, 2, 2 + 2 * BANDS
# Of `sizes`: tiles along a row, tiles of a camera, side of a tile in pixels, channels that end in front, whether the
# median is asked for.
_ACROSS, _OF_CAMERA, _SIDE, _IN_FRONT, _MEDIAN = 0, 1, 2, 3, 4


@inlined
def thresholds(numbers):
    """The rules, as XLA hands them over."""
    return Thresholds(numbers[0], numbers[1], numbers[2], numbers[3], numbers[4])


@inlined
def first_tile(offsets, tiles, band):
    """Where a band begins: each has about as many pairs as the others."""
    wanted, low, high = offsets[tiles] * band // BANDS, 0, tiles
    while low < high:
        middle = (low + high) // 2
        if offsets[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    return tiles if band == BANDS else low


@inlined
def tile_center(tile, sizes):
    """The centre of a tile, pixels of its image."""
    within, side = tile % sizes[_OF_CAMERA], np.float32(sizes[_SIDE])
    return (np.float32(within % sizes[_ACROSS]) + HALF) * side, (np.float32(within // sizes[_ACROSS]) + HALF) * side


@inlined
def gather(rows, count, on, in_front, splats, pairs, alpha_min, places, ids, near):
    """Copies the rows of a band's splats next to each other, as `tiles` wants them.

    Args:
        rows: `[count, GEOMETRY + on + in_front]` all splats.
        count: How many.
        on: Channels that go on to the end.
        in_front: Channels that end in front.
        splats: `[pairs]` the band's lists.
        pairs: How many.
        alpha_min: The alpha cut.
        places: `[count]` int32, written: where a splat's copy is, -1 for none.
        ids: `[pairs]` int32, written: the lists in terms of copies.
        near: `[.., CHANNELS + D]`, written: the copies.

    Returns:
        The number of copies.
    """
    through = at_least_three(on)
    given, width, copies = GEOMETRY + on + in_front, CHANNELS + through + in_front, 0
    for splat in range(count):
        places[splat] = -1
    for k in range(pairs):
        prefetch(floats_at(rows, np.int64(splats[min(k + AHEAD, pairs - 1)]) * given))
        # Lists may come from a caller: what is no splat must not be read.
        splat = min(max(np.int64(splats[k]), 0), count - 1)
        if places[splat] < 0:
            places[splat] = copies
            row, copy = floats_at(rows, splat * given), floats_at(near, copies * width)
            for c in range(GEOMETRY):
                copy[c] = row[c]
            for c in range(CHANNELS, width):
                copy[c] = ZERO
            for d in range(on):
                copy[CHANNELS + d] = row[GEOMETRY + d]
            for d in range(in_front):
                copy[CHANNELS + through + d] = row[GEOMETRY + on + d]
            copies += 1
        ids[k] = places[splat]
    for place in range(copies):
        copy = floats_at(near, place * width)
        copy[REACH] = reach_along_y(copy[2], copy[3], copy[4], copy[5], alpha_min)
    return copies


@inlined
def shape_of(frame, sizes):
    """Splats, channels that go on, channels that end in front, numbers of a copied row, and side of a tile."""
    buffer, in_front = argument(frame, 0), np.int64(sizes[_IN_FRONT])
    on = length(buffer, 1) - GEOMETRY - in_front
    return length(buffer, 0), on, in_front, CHANNELS + at_least_three(on) + in_front, np.int64(sizes[_SIDE])


@inlined
def blend_band(job, band):
    """Blends the tiles of a band."""
    frame = word(job, _FRAME)
    rows, splats, offsets = floats(argument(frame, 0)), int32s(argument(frame, 1)), int32s(argument(frame, 2))
    sizes, rules = int32s(argument(frame, 3)), floats(argument(frame, 4))
    features, light = floats(result(frame, 0)), floats(result(frame, 1))
    last, median = int32s(result(frame, 2)), int32s(result(frame, 3))
    count, on, in_front, width, side = shape_of(frame, sizes)
    tiles, pixels = length(result(frame, 1), 0), side * side

    from_tile, to_tile = first_tile(offsets, tiles, band), first_tile(offsets, tiles, band + 1)
    start, pairs = np.int64(offsets[from_tile]), np.int64(offsets[to_tile]) - offsets[from_tile]
    at_places, at_ids, at_near = allocate(4 * count), allocate(4 * pairs), allocate(4 * min(pairs, count) * width)
    if at_places != 0 and at_ids != 0 and at_near != 0:
        places, ids, near = as_int32s(at_places), as_int32s(at_ids), as_floats(at_near)
        gather(rows, count, on, in_front, int32s_at(splats, start), pairs, rules[1], places, ids, near)
        for tile in range(from_tile, to_tile):
            x, y = tile_center(tile, sizes)
            blend_tile(
                near, int32s_at(ids, offsets[tile] - start), offsets[tile + 1] - offsets[tile], x, y, side, on,
                in_front, sizes[_MEDIAN] != 0, thresholds(rules), floats_at(features, tile * (on + in_front) * pixels),
                floats_at(light, tile * pixels), int32s_at(last, tile * pixels), int32s_at(median, tile * pixels),
            )  # fmt: skip
    else:
        set_word(job, _LACKED, 1)
    release(at_places)
    release(at_ids)
    release(at_near)


@inlined
def unblend_band(job, band):
    """Sums, of every splat that a band's tiles show, the moments of dL/dsigma and the gradients to channels."""
    frame = word(job, _FRAME)
    rows, splats, offsets = floats(argument(frame, 0)), int32s(argument(frame, 1)), int32s(argument(frame, 2))
    light, last = floats(argument(frame, 3)), int32s(argument(frame, 4))
    d_features, d_light = floats(argument(frame, 5)), floats(argument(frame, 6))
    sizes, rules = int32s(argument(frame, 7)), floats(argument(frame, 8))
    count, on, in_front, width, side = shape_of(frame, sizes)
    tiles, pixels = length(argument(frame, 3), 0), side * side

    from_tile, to_tile = first_tile(offsets, tiles, band), first_tile(offsets, tiles, band + 1)
    start, pairs = np.int64(offsets[from_tile]), np.int64(offsets[to_tile]) - offsets[from_tile]
    at_places, at_ids, at_near = allocate(4 * count), allocate(4 * pairs), allocate(4 * min(pairs, count) * width)
    at_sums = 0
    if at_places != 0 and at_ids != 0 and at_near != 0:
        places, ids, near = as_int32s(at_places), as_int32s(at_ids), as_floats(at_near)
        copies = gather(rows, count, on, in_front, int32s_at(splats, start), pairs, rules[1], places, ids, near)
        at_sums = allocate(4 * copies * width)
        if at_sums != 0:
            sums = as_floats(at_sums)
            for place in range(copies * width):
                sums[place] = ZERO
            for tile in range(from_tile, to_tile):
                x, y = tile_center(tile, sizes)
                unblend_tile(
                    near, int32s_at(ids, offsets[tile] - start), x, y, side, on, in_front, thresholds(rules),
                    floats_at(light, tile * pixels), int32s_at(last, tile * pixels),
                    floats_at(d_features, tile * (on + in_front) * pixels), floats_at(d_light, tile * pixels), sums,
                )  # fmt: skip
    if at_sums == 0:
        set_word(job, _LACKED, 1)
    release(at_ids)
    release(at_near)
    set_word(job, _BANDS + 2 * band, at_places)
    set_word(job, _BANDS + 2 * band + 1, at_sums)


@inlined
def add_chunk(job, chunk):
    """Adds what the bands summed for some of the rows, and goes on to rows as `compositing.chain_to_rows` does."""
    frame = word(job, _FRAME)
    rows, d_rows, sizes = floats(argument(frame, 0)), floats(result(frame, 0)), int32s(argument(frame, 7))
    count, on, in_front, width, _ = shape_of(frame, sizes)
    given, through = GEOMETRY + on + in_front, at_least_three(on)
    for splat in range(count * chunk // CHUNKS, count * (chunk + 1) // CHUNKS):
        row, total = floats_at(rows, splat * given), floats_at(d_rows, splat * given)
        for c in range(given):
            total[c] = ZERO
        for band in range(BANDS):
            places, sums_of_band = as_int32s(word(job, _BANDS + 2 * band)), as_floats(word(job, _BANDS + 2 * band + 1))
            place, later = np.int64(places[splat]), np.int64(places[min(splat + AHEAD, count - 1)])
            prefetch(floats_at(sums_of_band, max(later, 0) * width))
            if place >= 0:
                sums = floats_at(sums_of_band, place * width)
                for c in range(GEOMETRY):
                    total[c] += sums[c]
                for d in range(on):
                    total[GEOMETRY + d] += sums[CHANNELS + d]
                for d in range(in_front):
                    total[GEOMETRY + on + d] += sums[CHANNELS + through + d]
        xx, xy, yy, opacity = row[2], row[3], row[4], row[5]
        m1, mx, my, mxx, mxy, myy = total[0], total[1], total[2], total[3], total[4], total[5]
        total[0], total[1] = xx * mx + xy * my, xy * mx + yy * my
        total[2], total[3], total[4] = HALF * mxx, mxy, HALF * myy
        total[5] = -m1 / (opacity if opacity > ZERO else ONE)


@entry_point(TASK)
def blend_bands(shared):
    """Blends bands until none is left."""
    band = next_item(shared)
    while band >= 0:
        blend_band(job_of(shared), band)
        band = item_after(shared)
    let_go(shared)


@entry_point(TASK)
def unblend_bands(shared):
    """Walks back over bands until none is left."""
    band = next_item(shared)
    while band >= 0:
        unblend_band(job_of(shared), band)
        band = item_after(shared)
    let_go(shared)


@entry_point(TASK)
def add_chunks(shared):
    """Adds chunks of rows until none is left."""
    chunk = next_item(shared)
    while chunk >= 0:
        add_chunk(job_of(shared), chunk)
        chunk = item_after(shared)
    let_go(shared)


for _task in (blend_bands, unblend_bands, add_chunks):
    define(f"rasterizer_{_task.__name__}", _task.address)


@entry_point(HANDLER)
def forward(frame):
    """(rows, splats, offsets, sizes, rules) -> features, light, last, median; see `compositing.Engine`."""
    if only_introduces(frame):
        return 0
    job = words_on_stack(2)
    set_word(job, _FRAME, frame)
    set_word(job, _LACKED, 0)
    began = share(frame, address_of("rasterizer_blend_bands"), job, BANDS)
    return 0 if began and word(job, _LACKED) == 0 else no_memory(frame)


@entry_point(HANDLER)
def backward(frame):
    """(rows, splats, offsets, light, last, d_features, d_light, sizes, rules) -> d_rows."""
    if only_introduces(frame):
        return 0
    job = words_on_stack(_JOB_WORDS)
    for place in range(_JOB_WORDS):
        set_word(job, place, 0)
    set_word(job, _FRAME, frame)
    done = share(frame, address_of("rasterizer_unblend_bands"), job, BANDS) and word(job, _LACKED) == 0
    done = done and share(frame, address_of("rasterizer_add_chunks"), job, CHUNKS)
    for place in range(_BANDS, _JOB_WORDS):
        release(word(job, place))
    return 0 if done else no_memory(frame)
