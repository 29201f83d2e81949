"""The two passes over an image, as XLA calls them: tiles in bands, a band a thread's work.

A band copies the rows of the splats that it meets, in the order in which it meets them, so that a tile's splats lie
close together. On the way back it sums into rows of its own; these are added band by band, so that the bits of a
gradient do not depend on the order of the threads.

Where a caller gives the arguments of `lists` in place of lists, each pass lists the splats in memory of the call. The
way back lists them again, which takes less time than a caller would lose whose capacity is too small.
"""

import numpy as np

from rasterizer._native.blending import HALF, ONE, ZERO, Thresholds
from rasterizer._native.calls import (
    ARGUMENTS,
    allocate,
    argument,
    count_arguments,
    data,
    finish,
    floats,
    int32s,
    int32s_of,
    length,
    only_introduces,
    release,
    result,
    set_word,
    set_words,
    share,
    word,
)
from rasterizer._native.compiled import handler, inlined
from rasterizer._native.instructions import (
    as_floats,
    as_int32s,
    floats_at,
    int32s_at,
    prefetch,
    words_on_stack,
)
from rasterizer._native.lists import LIST_WORDS, OFFSETS, SPLATS, list_splats
from rasterizer._native.tiles import (
    CHANNELS,
    GEOMETRY,
    REACH,
    THREE,
    blend_tile,
    reach_along_y,
    unblend_tile,
)

BANDS = 6  # How many are best depends little on the scene; no more threads than these share a pass.
AHEAD = 16  # splats: memory answers about so many later
CHUNKS = 16  # Of rows, whose gradients are added together.
LISTED = 8  # arguments of `lists`
# Of a job: its frame, how many arguments are of lists, how many tiles there are, whether memory was lacking; where the
# lists and their offsets are; then two words a band: where its splats' sums are, and these.
_FRAME, _LISTED, _TILES, _LACKED, _SPLATS, _OFFSETS, _BANDS = range(7)
_JOB_WORDS = _BANDS + 2 * BANDS
# Of `sizes`: tiles along a row, tiles of a camera, side of a tile in pixels, channels that end in front, whether the
# median is computed, probes.
_ACROSS, _OF_CAMERA, _SIDE, _IN_FRONT, _WITH_MEDIAN, _PROBES = range(6)


@inlined
def rows_of(job):
    """The record of the rows."""
    return argument(word(job, _FRAME), 0)


@inlined
def sizes_of(job):
    """The whole numbers, see `_ACROSS`."""
    frame = word(job, _FRAME)
    return int32s(argument(frame, count_arguments(frame) - 2))


@inlined
def thresholds_of(job):
    """The rules."""
    frame = word(job, _FRAME)
    numbers = floats(argument(frame, count_arguments(frame) - 1))
    return Thresholds(numbers[0], numbers[1], numbers[2], numbers[3], numbers[4])


@inlined
def backward_argument(job, place):
    """The record of an argument of the way back, from those behind the lists on."""
    return argument(word(job, _FRAME), word(job, _LISTED) + 1 + place)


@inlined
def first_tile(offsets, tiles, band):
    """Where a band begins: each has about as many pairs as the others."""
    first_pair, low, high = offsets[tiles] * band // BANDS, 0, tiles
    while low < high:
        middle = (low + high) // 2
        if offsets[middle] < first_pair:
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
def gather(job, from_tile, to_tile):
    """Copies the rows of the splats that some tiles show next to each other, as `tiles` wants them.

    Returns:
        Addresses of int32 where each splat's copy is (-1 for none), of the tiles' lists in terms of copies, and of the
        copies; and how many these are, -1 where memory was lacking.
    """
    rows, offsets = floats(rows_of(job)), int32s_of(job, _OFFSETS)
    count, row_size, on, in_front, width, _ = shape_of(job)
    through, copies = max(on, THREE), 0
    start, pairs = np.int64(offsets[from_tile]), np.int64(offsets[to_tile]) - offsets[from_tile]
    at_places, at_ids, at_near = allocate(4 * count), allocate(4 * pairs), allocate(4 * min(pairs, count) * width)
    if at_places == 0 or at_ids == 0 or at_near == 0:
        set_word(job, _LACKED, 1)
        return at_places, at_ids, at_near, -1
    splats, alpha_min = int32s_at(int32s_of(job, _SPLATS), start), thresholds_of(job).alpha_min
    places, ids, near = as_int32s(at_places), as_int32s(at_ids), as_floats(at_near)
    for splat in range(count):
        places[splat] = -1
    for k in range(pairs):
        prefetch(floats_at(rows, np.int64(splats[min(k + AHEAD, pairs - 1)]) * row_size))
        # Lists may come from a caller: what is no splat must not be read.
        splat = min(max(np.int64(splats[k]), 0), count - 1)
        if places[splat] < 0:
            places[splat] = copies
            row, copy = floats_at(rows, splat * row_size), floats_at(near, copies * width)
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
    return at_places, at_ids, at_near, copies


@inlined
def shape_of(job):
    """Splats, numbers of a row, channels blended to the end, those that end in front, numbers of a copy, tile side."""
    rows, sizes = rows_of(job), sizes_of(job)
    row_size, in_front = length(rows, 1), np.int64(sizes[_IN_FRONT])
    on = row_size - GEOMETRY - in_front
    return length(rows, 0), row_size, on, in_front, CHANNELS + max(on, THREE) + in_front, np.int64(sizes[_SIDE])


@inlined
def probes_of(job):
    """Channels of zeros that have a gradient; rows and images have no number of them."""
    return np.int64(sizes_of(job)[_PROBES])


@inlined
def blend_band(job, band):
    """Blends the tiles of a band."""
    frame, offsets, sizes, rules = word(job, _FRAME), int32s_of(job, _OFFSETS), sizes_of(job), thresholds_of(job)
    features, light = floats(result(frame, 0)), floats(result(frame, 1))
    last, median = int32s(result(frame, 2)), int32s(result(frame, 3))
    _, _, on, in_front, _, side = shape_of(job)
    tiles, pixels = word(job, _TILES), side * side

    from_tile, to_tile = first_tile(offsets, tiles, band), first_tile(offsets, tiles, band + 1)
    at_places, at_ids, at_near, copies = gather(job, from_tile, to_tile)
    if copies >= 0:
        ids, near, start = as_int32s(at_ids), as_floats(at_near), np.int64(offsets[from_tile])
        for tile in range(from_tile, to_tile):
            x, y = tile_center(tile, sizes)
            blend_tile(
                near, int32s_at(ids, offsets[tile] - start), offsets[tile + 1] - offsets[tile], x, y, side, on,
                in_front, sizes[_WITH_MEDIAN] != 0, rules,
                floats_at(features, tile * (on + in_front) * pixels), floats_at(light, tile * pixels),
                int32s_at(last, tile * pixels), int32s_at(median, tile * pixels),
            )  # fmt: skip
    release(at_places)
    release(at_ids)
    release(at_near)


@inlined
def unblend_band(job, band):
    """Sums, of every splat that a band's tiles show, the moments of dL/dsigma and the gradients to channels."""
    offsets, sizes, rules = int32s_of(job, _OFFSETS), sizes_of(job), thresholds_of(job)
    light, last = floats(backward_argument(job, 0)), int32s(backward_argument(job, 1))
    d_features, d_light = floats(backward_argument(job, 2)), floats(backward_argument(job, 3))
    _, _, on, in_front, width, side = shape_of(job)
    tiles, pixels, probes = word(job, _TILES), side * side, probes_of(job)

    from_tile, to_tile = first_tile(offsets, tiles, band), first_tile(offsets, tiles, band + 1)
    at_places, at_ids, at_near, copies = gather(job, from_tile, to_tile)
    at_sums = 0
    if copies >= 0:
        ids, near, start = as_int32s(at_ids), as_floats(at_near), np.int64(offsets[from_tile])
        at_sums = allocate(4 * copies * (width + probes))
        if at_sums != 0:
            sums = as_floats(at_sums)
            for place in range(copies * (width + probes)):
                sums[place] = ZERO
            for tile in range(from_tile, to_tile):
                x, y = tile_center(tile, sizes)
                unblend_tile(
                    near, int32s_at(ids, offsets[tile] - start), x, y, side, on, in_front, probes, rules,
                    floats_at(light, tile * pixels), int32s_at(last, tile * pixels),
                    floats_at(d_features, tile * (on + in_front + probes) * pixels),
                    floats_at(d_light, tile * pixels), sums,
                )  # fmt: skip
    if at_sums == 0:
        set_word(job, _LACKED, 1)
    release(at_ids)
    release(at_near)
    set_words(job, _BANDS + 2 * band, at_places, at_sums)


@inlined
def add_chunk(job, chunk):
    """Adds what the bands summed for some of the rows, and applies the chain rule of `compositing.chain_to_rows`."""
    rows, d_rows = floats(rows_of(job)), floats(result(word(job, _FRAME), 0))
    count, row_size, on, in_front, width, _ = shape_of(job)
    through, probes = max(on, THREE), probes_of(job)
    for splat in range(count * chunk // CHUNKS, count * (chunk + 1) // CHUNKS):
        row, total = floats_at(rows, splat * row_size), floats_at(d_rows, splat * (row_size + probes))
        for c in range(row_size + probes):
            total[c] = ZERO
        for band in range(BANDS):
            places, sums_of_band = as_int32s(word(job, _BANDS + 2 * band)), as_floats(word(job, _BANDS + 2 * band + 1))
            place, later = np.int64(places[splat]), np.int64(places[min(splat + AHEAD, count - 1)])
            prefetch(floats_at(sums_of_band, max(later, 0) * (width + probes)))
            if place >= 0:
                sums = floats_at(sums_of_band, place * (width + probes))
                for c in range(GEOMETRY):
                    total[c] += sums[c]
                for d in range(on):
                    total[GEOMETRY + d] += sums[CHANNELS + d]
                for d in range(in_front + probes):
                    total[GEOMETRY + on + d] += sums[CHANNELS + through + d]
        xx, xy, yy, opacity = row[2], row[3], row[4], row[5]
        m1, mx, my, mxx, mxy, myy = total[0], total[1], total[2], total[3], total[4], total[5]
        total[0], total[1] = xx * mx + xy * my, xy * mx + yy * my
        total[2], total[3], total[4] = HALF * mxx, mxy, HALF * myy
        total[5] = -m1 / (opacity if opacity > ZERO else ONE)


@inlined
def begin(job, lists_job, frame, listed, tiles):
    """Writes a job, and lists the splats where the caller gave no lists. Whether there was memory.

    A frame has rows, `listed` arguments (the lists or the arguments of `lists`), the pass's own, sizes and rules.
    """
    for place in range(_JOB_WORDS):
        set_word(job, place, 0)
    set_words(job, _FRAME, frame, listed, tiles)
    if listed == LISTED:
        done = list_splats(lists_job, frame, word(frame, ARGUMENTS) + 8, tiles, 0, 0, 0)
        set_words(job, _SPLATS, word(lists_job, SPLATS), word(lists_job, OFFSETS))
        return done
    set_words(job, _SPLATS, data(argument(frame, 1)), data(argument(frame, 2)))
    return True


@inlined
def end(job):
    """Gives back the memory of the lists that `begin` made, and of the bands' sums."""
    if word(job, _LISTED) == LISTED:
        release(word(job, _SPLATS))
        release(word(job, _OFFSETS))
    for place in range(_BANDS, _JOB_WORDS):
        release(word(job, place))


@inlined
def name_medians(job, medians, pixels):
    """Turns places in the tiles' lists into the splats that are listed there."""
    splats, offsets = int32s_of(job, _SPLATS), int32s_of(job, _OFFSETS)
    for tile in range(word(job, _TILES)):
        for p in range(tile * pixels, (tile + 1) * pixels):
            if medians[p] >= 0:
                medians[p] = splats[offsets[tile] + medians[p]]


@handler
def forward(frame):
    """(rows, *lists, sizes, rules) -> features, light, last, median; see `compositing.Engine`."""
    if only_introduces(frame):
        return 0
    job, lists_job, light = words_on_stack(_JOB_WORDS), words_on_stack(LIST_WORDS), result(frame, 1)
    done = begin(job, lists_job, frame, count_arguments(frame) - 3, length(light, 0))
    done = done and share(frame, blend_band, job, BANDS) and word(job, _LACKED) == 0
    if done:
        name_medians(job, int32s(result(frame, 3)), length(light, 1))
    end(job)
    return finish(frame, done)


@handler
def backward(frame):
    """(rows, *lists, light, last, d_features, d_light, sizes, rules) -> d_rows."""
    if only_introduces(frame):
        return 0
    job, lists_job, listed = words_on_stack(_JOB_WORDS), words_on_stack(LIST_WORDS), count_arguments(frame) - 7
    done = begin(job, lists_job, frame, listed, length(argument(frame, listed + 1), 0))
    done = done and share(frame, unblend_band, job, BANDS) and word(job, _LACKED) == 0
    done = done and share(frame, add_chunk, job, CHUNKS)
    end(job)
    return finish(frame, done)
