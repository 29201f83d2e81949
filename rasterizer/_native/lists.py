"""The lists of `rasterizer.bin_splats` as loops: one sort of the splats by depth, then rows of tiles by themselves.

A splat goes to a tile where the same test of the same numbers sends it there: the lists are those of the other
backends to the last entry. They are written into a result of XLA's, or into memory of exactly their length.
"""

import numpy as np

from rasterizer._native.blending import HALF, ONE, ZERO
from rasterizer._native.calls import (
    ARGUMENTS,
    allocate,
    data,
    finish,
    flags,
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
    as_int64s,
    floats_at,
    int32s_at,
    prefetch,
    words_on_stack,
)

BANDS = 16  # of rows of tiles: a band is a thread's work
CHUNKS = 16  # of splats, too
AHEAD = 16  # splats: memory answers about so many later
DIGIT = 11  # bits that are sorted by at once
DIGITS = 1 << DIGIT
# A record of a splat is a line of the cache. It begins with int32: its tiles (from and to along x, rows from and to),
# the first row of its camera, its id. Then come float32 of its ellipse: centre, conic, cut, and how far it leans along
# one axis per pixel along the other.
LINE, ELLIPSE = 64, 24  # bytes
SPAN = 12  # bytes of a splat's span, which is int32: its bands, from and to, and the tiles of its box
# Of a job: its arguments, the lists and their capacity, offsets, and the needed capacity; the order and its length,
# where records, spans, counts of tiles and the bands' splats are; then where each band's splats begin.
_ARGUMENTS, SPLATS, _CAPACITY, OFFSETS, _NEEDED = range(5)
_ORDER, _NUM_VISIBLE, _RECORDS, _SPANS, _COUNTS, _MEMBERS, _STARTS = range(5, 12)
LIST_WORDS = _STARTS + BANDS + 1
# Of `sizes`: tiles along a row, rows of tiles, side of a tile in pixels, cameras.
_ACROSS, _DOWN, _SIDE, _CAMERAS = 0, 1, 2, 3


@inlined
def least_sigma(x_low, y_low, x_high, y_high, ellipse):
    """Least Mahalanobis term over a box of offsets from the splat's centre, see `binning._least_sigma`."""
    xx, xy, yy = ellipse[2], ellipse[3], ellipse[4]
    x, y = min(max(ZERO, x_low), x_high), min(max(ZERO, y_low), y_high)
    along_y = min(max(ellipse[6] * x, y_low), y_high)
    along_x = min(max(ellipse[7] * y, x_low), x_high)
    of_x = HALF * (xx * x * x + yy * along_y * along_y) + xy * x * along_y
    of_y = HALF * (xx * along_x * along_x + yy * y * y) + xy * along_x * y
    least = min(of_x if x != ZERO else np.float32(np.inf), of_y if y != ZERO else np.float32(np.inf))
    return ZERO if (x == ZERO) & (y == ZERO) else least


@inlined
def order_by_depth(depths, visible, count, order, keys, other_order, other_keys):
    """Writes the ids of what is visible to `order`, front to back, equal depths by id; returns how many there are.

    All but `visible` are `[count]` int32. The bits of depths order as these do, since they are positive.
    """
    num_visible = 0
    for splat in range(count):
        if visible[splat]:
            other_keys[num_visible], other_order[num_visible] = depths[splat], splat
            num_visible += 1
    # Three digits of 32 bits: an odd number of passes ends in `order`.
    for digit in range(3):
        if digit == 1:
            sort_by_digit(order, keys, other_order, other_keys, num_visible, digit * DIGIT)
        else:
            sort_by_digit(other_order, other_keys, order, keys, num_visible, digit * DIGIT)
    return num_visible


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


@inlined
def list_argument(job, place):
    """The record of an argument of `lists`."""
    return word(word(job, _ARGUMENTS), place)


@inlined
def box_of(job, k):
    """The whole numbers of the record of the splat that comes k-th."""
    return as_int32s(word(job, _RECORDS) + LINE * k)


@inlined
def ellipse_of(job, k):
    """The others."""
    return as_floats(word(job, _RECORDS) + LINE * k + ELLIPSE)


@inlined
def span_of(job, k):
    """The span of the splat that comes k-th."""
    return as_int32s(word(job, _SPANS) + SPAN * k)


@inlined
def first_row_of(band, rows):
    """The first row of tiles of a band."""
    return rows * band // BANDS


@inlined
def band_of(row, rows):
    """The band that a row of tiles belongs to."""
    band = min(row * BANDS // max(rows, 1), BANDS - 1)
    while first_row_of(band + 1, rows) <= row:
        band += 1
    return band


@inlined
def write_chunk(job, chunk):
    """Writes where some of the ordered splats are, one after the other, so that the bands read them in one sweep."""
    num_visible, order = word(job, _NUM_VISIBLE), int32s_of(job, _ORDER)
    means2d, conics = floats(list_argument(job, 0)), floats(list_argument(job, 1))
    extents, cuts, sizes = floats(list_argument(job, 3)), floats(list_argument(job, 5)), int32s(list_argument(job, 7))
    across, down, side = np.float32(sizes[_ACROSS]), np.float32(sizes[_DOWN]), np.float32(sizes[_SIDE])
    per_camera = max(length(list_argument(job, 2), 0) // sizes[_CAMERAS], 1)
    for k in range(num_visible * chunk // CHUNKS, num_visible * (chunk + 1) // CHUNKS):
        splat, later = np.int64(order[k]), np.int64(order[min(k + AHEAD, num_visible - 1)])
        prefetch(floats_at(means2d, 2 * later))
        prefetch(floats_at(conics, 3 * later))
        prefetch(floats_at(extents, 2 * later))
        mean, extent, conic = floats_at(means2d, 2 * splat), floats_at(extents, 2 * splat), floats_at(conics, 3 * splat)
        from_x, to_x = tile_range(mean[0], extent[0], side, across)
        from_y, to_y = tile_range(mean[1], extent[1], side, down)
        first_row = splat // per_camera * sizes[_DOWN]
        box, ellipse = box_of(job, k), ellipse_of(job, k)
        box[0], box[1], box[2], box[3] = from_x, to_x, first_row + from_y, first_row + to_y
        box[4], box[5] = first_row, splat
        # Here, where threads share the divisions: one thread alone goes over all spans afterwards.
        span, rows = span_of(job, k), np.int64(sizes[_DOWN]) * sizes[_CAMERAS]
        span[0], span[1], span[2] = 0, 0, 0
        if from_x < to_x and from_y < to_y:
            span[0], span[1] = band_of(first_row + from_y, rows), band_of(first_row + to_y - 1, rows) + 1
            span[2] = (to_x - from_x) * (to_y - from_y)
        ellipse[0], ellipse[1], ellipse[5] = mean[0], mean[1], cuts[splat]
        ellipse[2], ellipse[3], ellipse[4] = conic[0], conic[1], conic[2]
        ellipse[6], ellipse[7] = -conic[1] / conic[2], -conic[1] / conic[0]


@inlined
def share_out(job):
    """Counts the splats of every band and writes where they begin; returns the tiles of all boxes together."""
    starts = as_int64s(job + 8 * _STARTS)
    tiles = 0
    for band in range(BANDS + 1):
        starts[band] = 0
    for k in range(word(job, _NUM_VISIBLE)):
        span = span_of(job, k)
        tiles += span[2]
        for band in range(span[0], span[1]):
            starts[band + 1] += 1
    for band in range(BANDS):
        starts[band + 1] += starts[band]
    return tiles


@inlined
def write_members(job):
    """Writes the splats of every band, in their order."""
    starts, members = as_int64s(job + 8 * _STARTS), int32s_of(job, _MEMBERS)
    for k in range(word(job, _NUM_VISIBLE)):
        span = span_of(job, k)
        for band in range(span[0], span[1]):
            members[starts[band]] = k
            starts[band] += 1
    for band in range(BANDS, 0, -1):
        starts[band] = starts[band - 1]
    starts[0] = 0


@inlined
def is_listed(ellipse, column, row, side, masks, masked, tile):
    """Whether a splat's ellipse reaches a pixel centre of a tile that is wanted."""
    x = np.float32(column * side) + HALF - ellipse[0]
    y = np.float32(row * side) + HALF - ellipse[1]
    span = np.float32(side - 1)
    reaches = least_sigma(x, y, x + span, y + span, ellipse) <= ellipse[5]
    return reaches & (masks[tile] != 0) if masked else reaches


@inlined
def list_band(job, band, filling):
    """Counts the splats of every tile of a band; or, where these are known, writes its lists."""
    starts, members = as_int64s(job + 8 * _STARTS), int32s_of(job, _MEMBERS)
    sizes, masks, masked = int32s(list_argument(job, 7)), flags(list_argument(job, 6)), length(list_argument(job, 6), 0)
    splats, capacity = int32s_of(job, SPLATS), word(job, _CAPACITY)
    counts = as_int64s(word(job, _COUNTS))
    across, rows, side = np.int64(sizes[_ACROSS]), np.int64(sizes[_DOWN]) * sizes[_CAMERAS], np.int64(sizes[_SIDE])
    first, end = first_row_of(band, rows), first_row_of(band + 1, rows)
    if not filling:
        for tile in range(first * across, end * across):
            counts[tile] = 0
    for member in range(starts[band], starts[band + 1]):
        prefetch(box_of(job, np.int64(members[min(member + AHEAD, starts[band + 1] - 1)])))
        k = np.int64(members[member])
        box, ellipse = box_of(job, k), ellipse_of(job, k)
        for row in range(max(np.int64(box[2]), first), min(np.int64(box[3]), end)):
            for column in range(np.int64(box[0]), np.int64(box[1])):
                tile = row * across + column
                listed = is_listed(ellipse, column, row - box[4], side, masks, masked, tile)
                if not filling:
                    counts[tile] += listed
                elif listed:
                    if counts[tile] < capacity:
                        splats[counts[tile]] = box[5]
                    counts[tile] += 1


@inlined
def count_band(job, band):
    """Counts the splats of every tile of a band."""
    list_band(job, band, False)


@inlined
def fill_band(job, band):
    """Writes the lists of a band."""
    list_band(job, band, True)


@inlined
def write_offsets(job, tiles):
    """Writes the offsets, allocates lists that have no memory yet, and turns counts into where each list begins.

    Whether there was memory.
    """
    counts, total = as_int64s(word(job, _COUNTS)), 0
    if word(job, SPLATS) == 0:
        for tile in range(tiles):
            total += counts[tile]
        set_word(job, SPLATS, allocate(4 * total))
        set_word(job, _CAPACITY, total)
    capacity, total, offsets = word(job, _CAPACITY), 0, int32s_of(job, OFFSETS)
    for tile in range(tiles):
        length_of_list = counts[tile]
        offsets[tile], counts[tile] = min(total, capacity), total
        total += length_of_list
    offsets[tiles] = min(total, capacity)
    return word(job, SPLATS) != 0


@inlined
def list_splats(job, frame, arguments, tiles, splats, capacity, offsets):
    """Lists the splats. Whether there was memory for all that is written on the way.

    Where `splats` and `offsets` are 0, lists and offsets come to fresh memory, at the job's `SPLATS` and `OFFSETS`. The
    job is the address of `LIST_WORDS` words, `arguments` that of the records of the arguments of `lists`.
    """
    offsets = offsets if offsets != 0 else allocate(4 * (tiles + 1))
    set_words(job, _ARGUMENTS, arguments, splats, capacity, offsets)
    count = length(list_argument(job, 2), 0)
    workspace, at_members = allocate(LINE * (count + 1) + 8 * tiles + (4 + SPAN + 12) * count), 0
    done = workspace != 0 and offsets != 0
    if done:
        set_word(job, _RECORDS, (workspace + LINE - 1) // LINE * LINE)
        set_word(job, _COUNTS, word(job, _RECORDS) + LINE * count)
        set_word(job, _ORDER, word(job, _COUNTS) + 8 * tiles)
        set_word(job, _SPANS, word(job, _ORDER) + 4 * count)
        order, work = int32s_of(job, _ORDER), as_int32s(word(job, _SPANS) + SPAN * count)
        depths, visible = int32s(list_argument(job, 2)), flags(list_argument(job, 4))
        num_visible = order_by_depth(
            depths, visible, count, order, work, int32s_at(work, count), int32s_at(work, 2 * count)
        )
        set_word(job, _NUM_VISIBLE, num_visible)
        done = share(frame, write_chunk, job, CHUNKS)
    if done:
        set_word(job, _NEEDED, share_out(job))
        at_members = allocate(4 * word(job, _STARTS + BANDS))
        set_word(job, _MEMBERS, at_members)
        done = at_members != 0
    if done:
        write_members(job)
        done = share(frame, count_band, job, BANDS)
    done = done and write_offsets(job, tiles) and share(frame, fill_band, job, BANDS)
    release(workspace)
    release(at_members)
    return done


@handler
def lists(frame):
    """(means2d, conics, depths, extents, visible, cuts, masks, sizes) -> splats, offsets, needed."""
    if only_introduces(frame):
        return 0
    job, splats, offsets = words_on_stack(LIST_WORDS), result(frame, 0), result(frame, 1)
    to_write = data(splats), length(splats, 0), data(offsets)
    done = list_splats(job, frame, word(frame, ARGUMENTS), length(offsets, 0) - 1, *to_write)
    int32s(result(frame, 2))[0] = min(word(job, _NEEDED), 2**31 - 1) if done else 0
    return finish(frame, done)
