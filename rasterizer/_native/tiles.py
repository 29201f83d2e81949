"""One tile at a time, front to back and back to front.

A tile is cut into strips of eight columns, and a strip into blocks of as many pixels as a vector has lanes: one row, or
two. What is known of a block's pixels lies together, in the first cache. Only the blocks that a splat's ellipse reaches
along y are visited.
"""

import numpy as np

from rasterizer._native.blending import (
    HALF,
    ONE,
    ZERO,
    blend_splat,
    cut_alpha,
    exp_minus,
    front_weight,
    splat_sigma,
    unblend_in_front,
    unblend_splat,
)
from rasterizer._native.compiled import inlined
from rasterizer._native.instructions import floats_at, floats_on_stack
from rasterizer._native.vectors import (
    LANES,
    add_eight_sums,
    any_lane,
    broadcast,
    load,
    maximum,
    store,
    sum_of_lanes,
    where,
)

MAX_SIDE, MAX_CHANNELS = 32, 16  # pixels of a tile, channels of a pass
STRIP = 8  # columns; a tile is filled up to whole blocks with pixels that have stopped
ROWS = LANES // STRIP  # of a block

# Of a block, in numbers: pixel centres, light, place of the last splat that shows; then the place of the median splat
# on the way there, and what lies behind on the way back; then channels or their gradients, at least three of them:
# these share the blend's own loop.
PIXEL_X, PIXEL_Y, LIGHT, LATEST, MIDDLE = (LANES * slot for slot in range(5))
BEHIND, CHANNEL, THREE = MIDDLE, LANES * 5, 3
BLOCK = CHANNEL + LANES * (MAX_CHANNELS + THREE)
BLOCKS = MAX_SIDE * MAX_SIDE // LANES * BLOCK  # the numbers of a tile

GEOMETRY, REACH, CHANNELS = 6, 6, 7  # of a row: mean, conic, opacity; how far it reaches along y; its channels
PART_LANES = (MAX_CHANNELS + THREE) * LANES  # dL/dchannels of a splat over a tile, a number a lane each
LOOK = 8  # splats between two checks whether every pixel has stopped
FAR, MARGIN = 1e9, np.float32(1e-3)  # pixels


@inlined
def reach_along_y(conic_xx, conic_xy, conic_yy, opacity, alpha_min):
    """How far from its mean a splat's alpha can pass the cut, pixels; `FAR` where the conic has too few digits."""
    xx, xy, yy = np.float64(conic_xx), np.float64(conic_xy), np.float64(conic_yy)
    # Less what the rounding of the conic's three numbers can add to the determinant, four times over.
    det = xx * yy * (1 - 2.0**-21) - xy * xy
    # The margin of `binning.bin_splats`.
    cut = np.log(max(np.float64(opacity) / alpha_min, 1.0)) * 1.0001 + 1e-4
    return np.float32(min(np.sqrt(2 * cut * xx / det), FAR)) if det > 0 else np.float32(FAR)


@inlined
def rows_reached(y, reach, side):
    """The first row of pixels that a splat reaches and the one after the last; `y` of its mean from the tile's top.

    All rows where one of the numbers is not a number: comparisons with it are false.
    """
    low, high, last = y - reach - HALF - MARGIN, y + reach - HALF + MARGIN, np.float32(side - 1)
    low, high = low if low > ZERO else ZERO, high if high < last else last
    return np.int64(np.ceil(min(low, np.float32(side)))), np.int64(np.floor(max(high, -ONE))) + 1


@inlined
def strips_of(side):
    """Strips of a tile's pixels."""
    return (side + STRIP - 1) // STRIP


@inlined
def blocks_of_strip(side):
    """Blocks of a strip."""
    return (side + ROWS - 1) // ROWS


@inlined
def place_of(x, y, side):
    """Where a pixel's numbers are."""
    block = x // STRIP * blocks_of_strip(side) + y // ROWS
    return block * BLOCK + y % ROWS * STRIP + x % STRIP


@inlined
def begin_blocks(blocks, side, channels):
    """Writes blocks of pixels that have stopped and show nothing, with their centres, from the tile's middle."""
    middle, of_strip = HALF * np.float32(side) - HALF, blocks_of_strip(side)
    for strip in range(strips_of(side)):
        for b in range(of_strip):
            block = floats_at(blocks, (strip * of_strip + b) * BLOCK)
            for j in range(LANES):
                block[PIXEL_X + j] = np.float32(strip * STRIP + j % STRIP) - middle
                block[PIXEL_Y + j] = np.float32(b * ROWS + j // STRIP) - middle
                block[LIGHT + j], block[LATEST + j], block[MIDDLE + j] = -ONE, -ONE, -ONE
            for j in range(CHANNEL, CHANNEL + LANES * channels):
                block[j] = ZERO


@inlined
def all_stopped(blocks, side):
    """Whether no light is left for anything more."""
    most = broadcast(-ONE)
    for b in range(strips_of(side) * blocks_of_strip(side)):
        most = maximum(most, load(floats_at(blocks, b * BLOCK + LIGHT)))
    return not any_lane(most > ZERO)


@inlined
def add_to(target, value):
    """Adds a vector to the one at a place."""
    store(target, load(target) + value)


@inlined
def raise_to(target, value):
    """Writes the larger of a vector and the one at a place."""
    store(target, maximum(load(target), value))


@inlined
def blend_list(blocks, rows, splats, count, center_x, center_y, side, through, until, rules, alone):
    """Blends a list onto blocks; `alone`, a literal: only three channels, and no median, are computed."""
    of_strip, width = blocks_of_strip(side), CHANNELS + through + until
    for k in range(count):
        row = floats_at(rows, splats[k] * width)
        x, y, xx, xy, yy, opacity = row[0] - center_x, row[1] - center_y, row[2], row[3], row[4], row[5]
        top, bottom = rows_reached(y + HALF * np.float32(side), row[REACH], side)
        r, g, b, place = row[CHANNELS], row[CHANNELS + 1], row[CHANNELS + 2], np.float32(k)
        for strip in range(strips_of(side)):
            first = floats_at(blocks, strip * of_strip * BLOCK)
            dx = x - load(floats_at(first, PIXEL_X))
            for n in range(top // ROWS, (bottom + ROWS - 1) // ROWS):
                block = floats_at(first, n * BLOCK)
                dy = y - load(floats_at(block, PIXEL_Y))
                alpha = cut_alpha(opacity * exp_minus(splat_sigma(dx, dy, xx, xy, yy)), rules)
                t = load(floats_at(block, LIGHT))
                weight, left = blend_splat(t, alpha, rules)
                store(floats_at(block, LIGHT), left)
                raise_to(floats_at(block, LATEST), where(weight > ZERO, place, -ONE))
                add_to(floats_at(block, CHANNEL), weight * r)
                add_to(floats_at(block, CHANNEL + LANES), weight * g)
                add_to(floats_at(block, CHANNEL + 2 * LANES), weight * b)
                if not alone:
                    raise_to(floats_at(block, MIDDLE), where((weight > ZERO) & (t > HALF), place, -ONE))
                    in_front = front_weight(t, weight, rules.stop_after)
                    for d in range(THREE, through):
                        add_to(floats_at(block, CHANNEL + LANES * d), weight * row[CHANNELS + d])
                    for d in range(through, through + until):
                        add_to(floats_at(block, CHANNEL + LANES * d), in_front * row[CHANNELS + d])
        if k % LOOK == LOOK - 1 and all_stopped(blocks, side):
            break


@inlined
def blend_tile(
    rows, splats, count, center_x, center_y, side, on, in_front, with_median, rules, features, light, last, median
):
    """Blends a tile's list front to back.

    Args:
        rows: `[.., CHANNELS + D]` splats, D at least three and the channels that end in front.
        splats: `[count]` the list, as rows of `rows`.
        count: How many there are.
        center_x: Of the tile, pixels of the image.
        center_y: The same along y.
        side: Of the tile, pixels.
        on: Channels that are blended to the end; they come first.
        in_front: Channels that end in front.
        with_median: Whether the median is computed; else what is written there means nothing.
        rules: `Thresholds`.
        features: `[D, P]`, written.
        light: `[P]`, written: what is left of it.
        last: `[P]` int32, written: the place in the list of the last splat that shows; -1 for none.
        median: `[P]` int32, written: the same of the last that shows with more than half the light before it.
    """
    through = max(on, THREE)  # with channels of zeros, where there are fewer
    blocks, pixels = floats_on_stack(BLOCKS), side * side
    begin_blocks(blocks, side, through + in_front)
    for y in range(side):
        for x in range(side):
            floats_at(blocks, place_of(x, y, side))[LIGHT] = ONE
    if through == THREE and in_front == 0 and not with_median:
        blend_list(blocks, rows, splats, count, center_x, center_y, side, through, in_front, rules, True)
    else:
        blend_list(blocks, rows, splats, count, center_x, center_y, side, through, in_front, rules, False)
    for y in range(side):
        for x in range(side):
            p, block = y * side + x, floats_at(blocks, place_of(x, y, side))
            light[p], last[p], median[p] = abs(block[LIGHT]), np.int32(block[LATEST]), np.int32(block[MIDDLE])
            for d in range(on):
                features[d * pixels + p] = block[CHANNEL + LANES * d]
            for d in range(in_front):
                features[(on + d) * pixels + p] = block[CHANNEL + LANES * (through + d)]


@inlined
def unblend_list(
    blocks, rows, splats, count, center_x, center_y, side, through, until, probes, rules, sums, alone, two
):
    """Walks back over a list.

    Literals: `alone`, only three channels are there; `two`, and as many probes, which stay in registers.
    """
    of_strip, channels = blocks_of_strip(side), through + until
    width, parts, zeros = CHANNELS + channels, floats_on_stack(PART_LANES), broadcast(ZERO)
    for k in range(count - 1, -1, -1):
        row, total = floats_at(rows, splats[k] * width), floats_at(sums, splats[k] * (width + probes))
        x, y, xx, xy, yy, opacity = row[0] - center_x, row[1] - center_y, row[2], row[3], row[4], row[5]
        top, bottom = rows_reached(y + HALF * np.float32(side), row[REACH], side)
        r, g, b, place = row[CHANNELS], row[CHANNELS + 1], row[CHANNELS + 2], np.float32(k)
        if not alone:
            for d in range(THREE, channels + probes):
                store(floats_at(parts, LANES * d), zeros)
        for strip in range(strips_of(side)):
            first = floats_at(blocks, strip * of_strip * BLOCK)
            dx = x - load(floats_at(first, PIXEL_X))
            m, my, myy, sum_r, sum_g, sum_b = zeros, zeros, zeros, zeros, zeros, zeros
            sum_p, sum_q = zeros, zeros
            for n in range(top // ROWS, (bottom + ROWS - 1) // ROWS):
                block = floats_at(first, n * BLOCK)
                dy = y - load(floats_at(block, PIXEL_Y))
                unclamped = opacity * exp_minus(splat_sigma(dx, dy, xx, xy, yy))
                alpha = where(load(floats_at(block, LATEST)) >= place, cut_alpha(unclamped, rules), ZERO)
                d_r, d_g = load(floats_at(block, CHANNEL)), load(floats_at(block, CHANNEL + LANES))
                d_b = load(floats_at(block, CHANNEL + 2 * LANES))
                lit = r * d_r + g * d_g + b * d_b
                t, behind = load(floats_at(block, LIGHT)), load(floats_at(block, BEHIND))
                if alone:
                    d_sigma, weight, t, behind = unblend_splat(t, behind, lit, alpha, unclamped, rules)
                else:
                    lit_in_front = zeros
                    for d in range(THREE, through):
                        lit = lit + row[CHANNELS + d] * load(floats_at(block, CHANNEL + LANES * d))
                    for d in range(through, channels):
                        lit_in_front = lit_in_front + row[CHANNELS + d] * load(floats_at(block, CHANNEL + LANES * d))
                    d_sigma, weight, t, behind = unblend_in_front(t, behind, lit, alpha, unclamped, rules, lit_in_front)
                    in_front = front_weight(t, weight, rules.stop_after)
                    for d in range(THREE, through):
                        add_to(floats_at(parts, LANES * d), weight * load(floats_at(block, CHANNEL + LANES * d)))
                    for d in range(through, channels):
                        add_to(floats_at(parts, LANES * d), in_front * load(floats_at(block, CHANNEL + LANES * d)))
                    if not two:
                        for d in range(channels, channels + probes):
                            add_to(floats_at(parts, LANES * d), weight * load(floats_at(block, CHANNEL + LANES * d)))
                if two:
                    sum_p = sum_p + weight * load(floats_at(block, CHANNEL + LANES * channels))
                    sum_q = sum_q + weight * load(floats_at(block, CHANNEL + LANES * (channels + 1)))
                store(floats_at(block, LIGHT), t)
                store(floats_at(block, BEHIND), behind)
                along_y = d_sigma * dy
                m, my, myy = m + d_sigma, my + along_y, myy + along_y * dy
                sum_r, sum_g, sum_b = sum_r + weight * d_r, sum_g + weight * d_g, sum_b + weight * d_b
            mx = m * dx
            add_eight_sums(total, (m, mx, my, mx * dx, my * dx, myy, zeros, sum_r))
            total[CHANNELS + 1] += sum_of_lanes(sum_g)
            total[CHANNELS + 2] += sum_of_lanes(sum_b)
            if two:
                total[CHANNELS + channels] += sum_of_lanes(sum_p)
                total[CHANNELS + channels + 1] += sum_of_lanes(sum_q)
        if not alone:
            for d in range(THREE, channels if two else channels + probes):
                total[CHANNELS + d] += sum_of_lanes(load(floats_at(parts, LANES * d)))


@inlined
def unblend_tile(
    rows, splats, center_x, center_y, side, on, in_front, probes, rules, light, last, d_features, d_light, sums
):
    """Walks back over a tile's list, from the last splat that shows; arguments as in `blend_tile`, which wrote some.

    `probes` are channels of zeros behind the others, which `rows` do not have. `d_features` `[D + probes, P]` and
    `d_light` `[P]` are dL/dfeatures and dL/dlight. Added to `sums`, which are like `rows` with probes: moments of
    dL/dsigma about the splats' means, and dL/dchannels.
    """
    through = max(on, THREE)
    blocks, pixels, count = floats_on_stack(BLOCKS), side * side, 0
    begin_blocks(blocks, side, through + in_front + probes)
    for y in range(side):
        for x in range(side):
            p, block = y * side + x, floats_at(blocks, place_of(x, y, side))
            block[LIGHT], block[BEHIND], block[LATEST] = light[p], light[p] * d_light[p], np.float32(last[p])
            count = max(count, last[p] + 1)
            for d in range(on):
                block[CHANNEL + LANES * d] = d_features[d * pixels + p]
            for d in range(in_front + probes):
                block[CHANNEL + LANES * (through + d)] = d_features[(on + d) * pixels + p]
    tile = blocks, rows, splats, count, center_x, center_y, side, through, in_front, probes, rules, sums
    is_alone = through == THREE and in_front == 0
    if is_alone and probes == 0:
        unblend_list(*tile, True, False)
    elif is_alone and probes == 2:
        unblend_list(*tile, True, True)
    elif probes == 2:
        unblend_list(*tile, False, True)
    else:
        unblend_list(*tile, False, False)
