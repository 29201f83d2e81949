"""The lists of `rasterizer.bin_splats` as loops: one sort of the splats by depth, then rows of tiles by themselves.

A splat goes to a tile where the same test of the same numbers sends it there: the lists are those of the other
backends to the last entry.
"""

import numpy as np

from rasterizer._native.blending import HALF, ONE, ZERO
from rasterizer._native.calls import (
    HANDLER,
    TASK,
    allocate,
    argument,
    flags,
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
from rasterizer._native.compiled import entry_point, inlined, part
from rasterizer._native.instructions import (
    address_of,
    as_floats,
    as_int32s,
    as_int64s,
    define,
    floats_at,
    int32s_at,
    words_on_stack,
)

BANDS = 16  # of rows of tiles: a band is a thread's work
DIGIT = 11  # bits that are sorted by at once
DIGITS = 1 << DIGIT
# Numbers of a splat: its tiles (from and to along x, rows from and to), the first row of its camera, its id; and its
# ellipse (centre, conic, cut).
BOX, ELLIPSE = 6, 6
# Of a job: its frame, how many splats are visible, where their boxes and ellipses are, where the tiles' counts are.
_FRAME, _VISIBLE, _BOXES, _ELLIPSES, _COUNTS, _JOB_WORDS = 0, 1, 2, 3, 4, 5
# Of `sizes`: tiles along a row, rows of tiles, side of a tile in pixels, cameras.
_ACROSS, _DOWN, _SIDE, _CAMERAS = 0, 1, 2, 3


@inlined
def least_sigma(x_low, y_low, x_high, y_high, xx, xy, yy):
    """Least Mahalanobis term over a box of offsets from the splat's centre, see `binning._least_sigma`."""
    x, y = min(max(ZERO, x_low), x_high), min(max(ZERO, y_low), y_high)
    if (x == ZERO) & (y == ZERO):
        return ZERO
    least = np.float32(np.inf)
    if x != ZERO:
        beside = min(max(-xy / yy * x, y_low), y_high)
        least = min(least, HALF * (xx * x * x + yy * beside * beside) + xy * x * beside)
    if y != ZERO:
        beside = min(max(-xy / xx * y, x_low), x_high)
        least = min(least, HALF * (xx * beside * beside + yy * y * y) + xy * beside * y)
    return least


@part
def order_by_depth(depths, visible, count, order, keys, other_order, other_keys):
    """Writes the ids of what is visible to `order`, front to back, equal depths by id; returns how many there are.

    Args:
        depths: `[count]` the bits of the depths as int32: they order as the depths do, since these are positive.
        visible: `[count]` bytes.
        count: How many splats there are.
        order: `[count]` int32, written.
        keys: `[count]` int32, workspace, as the other two.
        other_order: Workspace.
        other_keys: Workspace.
    """
    shown = 0
    for splat in range(count):
        if visible[splat]:
            other_keys[shown], other_order[shown] = depths[splat], splat
            shown += 1
    # Three digits of 32 bits: an odd number of passes ends in `order`.
    for digit in range(3):
        if digit == 1:
            sort_by_digit(order, keys, other_order, other_keys, shown, digit * DIGIT)
        else:
            sort_by_digit(other_order, other_keys, order, keys, shown, digit * DIGIT)
    return shown


@inlined
def sort_by_digit(order, keys, sorted_order, sorted_keys, count, shift):
    """One pass of a stable sort: by the bits of one digit."""
    starts = as_int64s(words_on_stack(DIGITS))
    for digit in range(DIGITS):
        starts[digit] = 0
    for k in range(count):
        starts[(keys[k] >> shift) & (DIGITS - 1)] += 1
    total = 0
    for digit in range(DIGITS):
        here = starts[digit]
        starts[digit] = total
        total += here
    for k in range(count):
        digit = (keys[k] >> shift) & (DIGITS - 1)
        place = starts[digit]
        sorted_order[place], sorted_keys[place] = order[k], keys[k]
        starts[digit] = place + 1


@inlined
def tile_range(center, reach, side, limit):
    """The tiles along an axis that an extent overlaps, from and to, see `binning._tile_boxes`."""
    low = np.floor((center - reach) / side)
    high = np.floor((center + reach) / side) + ONE
    # Cut to the image before the cast: a far-off mean would not fit an integer.
    return np.int32(min(max(low, ZERO), limit)), np.int32(min(max(high, ZERO), limit))


@part
def write_splats(means2d, conics, extents, cuts, count, order, shown, sizes, boxes, ellipses):
    """Writes where the splats of an order are, one after the other, so that every band reads them in one sweep."""
    across, down, side = np.float32(sizes[_ACROSS]), np.float32(sizes[_DOWN]), np.float32(sizes[_SIDE])
    per_camera = max(count // sizes[_CAMERAS], 1)
    for k in range(shown):
        splat = np.int64(order[k])
        mean, extent, conic = floats_at(means2d, 2 * splat), floats_at(extents, 2 * splat), floats_at(conics, 3 * splat)
        from_x, to_x = tile_range(mean[0], extent[0], side, across)
        from_y, to_y = tile_range(mean[1], extent[1], side, down)
        first_row = splat // per_camera * sizes[_DOWN]
        box, ellipse = int32s_at(boxes, BOX * k), floats_at(ellipses, ELLIPSE * k)
        box[0], box[1], box[2], box[3] = from_x, to_x, first_row + from_y, first_row + to_y
        box[4], box[5] = first_row, splat
        ellipse[0], ellipse[1], ellipse[5] = mean[0], mean[1], cuts[splat]
        ellipse[2], ellipse[3], ellipse[4] = conic[0], conic[1], conic[2]


@inlined
def is_listed(ellipse, column, row, side, masks, masked, tile):
    """Whether a splat's ellipse reaches a pixel centre of a tile that is wanted."""
    x = np.float32(column * side) + HALF - ellipse[0]
    y = np.float32(row * side) + HALF - ellipse[1]
    span = np.float32(side - 1)
    wanted = masked == 0 or masks[tile] != 0
    return wanted and least_sigma(x, y, x + span, y + span, ellipse[2], ellipse[3], ellipse[4]) <= ellipse[5]


@part
def list_band(job, band, filling):
    """Counts the splats of every tile of a band; or, where these are known, writes its lists."""
    frame = word(job, _FRAME)
    sizes, masks, masked = int32s(argument(frame, 7)), flags(argument(frame, 6)), length(argument(frame, 6), 0)
    splats, capacity = int32s(result(frame, 0)), length(result(frame, 0), 0)
    boxes, ellipses, counts = (
        as_int32s(word(job, _BOXES)),
        as_floats(word(job, _ELLIPSES)),
        as_int64s(word(job, _COUNTS)),
    )
    across, rows, side = np.int64(sizes[_ACROSS]), np.int64(sizes[_DOWN]) * sizes[_CAMERAS], np.int64(sizes[_SIDE])
    first, end = rows * band // BANDS, rows * (band + 1) // BANDS
    if not filling:
        for tile in range(first * across, end * across):
            counts[tile] = 0
    for k in range(word(job, _VISIBLE)):
        box, ellipse = int32s_at(boxes, BOX * k), floats_at(ellipses, ELLIPSE * k)
        for row in range(max(np.int64(box[2]), first), min(np.int64(box[3]), end)):
            for column in range(np.int64(box[0]), np.int64(box[1])):
                tile = row * across + column
                if is_listed(ellipse, column, row - box[4], side, masks, masked, tile):
                    place = counts[tile]
                    if filling and place < capacity:
                        splats[place] = box[5]
                    counts[tile] = place + 1


@entry_point(TASK)
def count_bands(shared):
    """Counts bands until none is left."""
    band = next_item(shared)
    while band >= 0:
        list_band(job_of(shared), band, False)
        band = item_after(shared)
    let_go(shared)


@entry_point(TASK)
def fill_bands(shared):
    """Writes the lists of bands until none is left."""
    band = next_item(shared)
    while band >= 0:
        list_band(job_of(shared), band, True)
        band = item_after(shared)
    let_go(shared)


for _task in (count_bands, fill_bands):
    define(f"rasterizer_{_task.__name__}", _task.address)


@part
def write_offsets(frame, counts, tiles):
    """Writes the offsets and the capacity that is needed, and turns counts into where each list begins."""
    capacity, total = length(result(frame, 0), 0), 0
    offsets, needed = int32s(result(frame, 1)), int32s(result(frame, 2))
    for tile in range(tiles):
        here = counts[tile]
        offsets[tile], counts[tile] = min(total, capacity), total
        total += here
    offsets[tiles] = min(total, capacity)
    needed[0] = min(total, 2**31 - 1)


@entry_point(HANDLER)
def lists(frame):
    """(means2d, conics, depths, extents, visible, cuts, masks, sizes) -> splats, offsets, needed."""
    if only_introduces(frame):
        return 0
    count, tiles = length(argument(frame, 2), 0), length(result(frame, 1), 0) - 1
    at_order, at_work, at_counts = allocate(4 * count), allocate(12 * count), allocate(8 * tiles)
    at_boxes, at_ellipses = allocate(4 * BOX * count), allocate(4 * ELLIPSE * count)
    done = at_order != 0 and at_work != 0 and at_counts != 0 and at_boxes != 0 and at_ellipses != 0
    if done:
        order, work = as_int32s(at_order), as_int32s(at_work)
        shown = order_by_depth(
            int32s(argument(frame, 2)), flags(argument(frame, 4)), count, order, work, int32s_at(work, count),
            int32s_at(work, 2 * count),
        )  # fmt: skip
        write_splats(
            floats(argument(frame, 0)), floats(argument(frame, 1)), floats(argument(frame, 3)),
            floats(argument(frame, 5)), count, order, shown, int32s(argument(frame, 7)), as_int32s(at_boxes),
            as_floats(at_ellipses),
        )  # fmt: skip
        job = words_on_stack(_JOB_WORDS)
        set_word(job, _FRAME, frame)
        set_word(job, _VISIBLE, shown)
        set_word(job, _BOXES, at_boxes)
        set_word(job, _ELLIPSES, at_ellipses)
        set_word(job, _COUNTS, at_counts)
        done = share(frame, address_of("rasterizer_count_bands"), job, BANDS)
        write_offsets(frame, as_int64s(at_counts), tiles)
        done = done and share(frame, address_of("rasterizer_fill_bands"), job, BANDS)
    release(at_order)
    release(at_work)
    release(at_counts)
    release(at_boxes)
    release(at_ellipses)
    return 0 if done else no_memory(frame)
