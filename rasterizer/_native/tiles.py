"""One tile at a time, front to back and back to front.

Its pixels lie in the first cache, eight side by side: what is known of eight pixels is one block of numbers, so that
LLVM makes a vector of each and finds all of them at one address. Only the rows of a tile that a splat's ellipse reaches
are visited.
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
from rasterizer._native.instructions import add_products, add_scaled, floats_at, floats_on_stack

MAX_SIDE, MAX_CHANNELS = 32, 16  # pixels of a tile, channels of a pass
LANES = 8  # pixels of a block; a row of a tile is filled up to whole blocks with pixels that have stopped

# Of a block, in numbers: pixel centres, light, place of the last splat that shows; then the place of the median splat
# on the way there, and what lies behind on the way back; then channels or their gradients, at least three of them:
# these share the blend's own loop.
PIXEL_X, PIXEL_Y, LIGHT, LATEST, MIDDLE = (LANES * slot for slot in range(5))
BEHIND, CHANNEL, THREE = MIDDLE, LANES * 5, 3
BLOCK = CHANNEL + LANES * (MAX_CHANNELS + THREE)
BLOCKS = MAX_SIDE * MAX_SIDE // LANES * BLOCK  # the numbers of a tile

GEOMETRY, REACH, CHANNELS = 6, 6, 7  # of a row: mean, conic, opacity; how far it reaches along y; its channels
PART_LANES = (GEOMETRY + MAX_CHANNELS + THREE) * LANES  # sums of a splat over a tile, a number a lane each
LOOK = 8  # splats between two checks whether every pixel has stopped
FAR, MARGIN = 1e9, np.float32(1e-3)  # pixels


@inlined
def at_least_three(on):
    """Channels that are blended to the end, with those of zeros that are added to have three."""
    return max(on, THREE)


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
def blocks_of_row(side):
    """Blocks of a row of a tile's pixels."""
    return (side + LANES - 1) // LANES


@inlined
def begin_blocks(blocks, side, channels):
    """Writes blocks of pixels that have stopped and show nothing, with their centres, from the tile's middle."""
    middle, of_row = HALF * np.float32(side) - HALF, blocks_of_row(side)
    for y in range(side):
        for b in range(of_row):
            block = floats_at(blocks, (y * of_row + b) * BLOCK)
            for j in range(LANES):
                block[PIXEL_X + j] = np.float32(b * LANES + j) - middle
                block[PIXEL_Y + j] = np.float32(y) - middle
                block[LIGHT + j], block[LATEST + j], block[MIDDLE + j] = -ONE, -ONE, -ONE
            for j in range(CHANNEL, CHANNEL + LANES * channels):
                block[j] = ZERO


@inlined
def all_stopped(blocks, side):
    """Whether no light is left for anything more."""
    most = -ONE
    for b in range(side * blocks_of_row(side)):
        block = floats_at(blocks, b * BLOCK)
        for j in range(LANES):
            most = max(most, block[LIGHT + j])
    return most <= ZERO


@inlined
def blend_list(blocks, rows, splats, count, center_x, center_y, side, through, until, rules, alone):
    """Blends a list onto blocks; `alone`, a literal: only three channels, and no median, are computed."""
    of_row, width = blocks_of_row(side), CHANNELS + through + until
    weights, in_front = floats_on_stack(LANES), floats_on_stack(LANES)
    for k in range(count):
        row = floats_at(rows, splats[k] * width)
        x, y, xx, xy, yy, opacity = row[0] - center_x, row[1] - center_y, row[2], row[3], row[4], row[5]
        top, bottom = rows_reached(y + HALF * np.float32(side), row[REACH], side)
        r, g, b, place = row[CHANNELS], row[CHANNELS + 1], row[CHANNELS + 2], np.float32(k)
        for n in range(top * of_row, bottom * of_row):
            block = floats_at(blocks, n * BLOCK)
            for j in range(LANES):
                sigma = splat_sigma(x - block[PIXEL_X + j], y - block[PIXEL_Y + j], xx, xy, yy)
                alpha = cut_alpha(opacity * exp_minus(sigma), rules)
                t = block[LIGHT + j]
                weight, left = blend_splat(t, alpha, rules)
                block[LIGHT + j] = left
                block[LATEST + j] = place if weight > ZERO else block[LATEST + j]
                block[CHANNEL + j] += weight * r
                block[CHANNEL + LANES + j] += weight * g
                block[CHANNEL + 2 * LANES + j] += weight * b
                if not alone:
                    block[MIDDLE + j] = place if (weight > ZERO) & (t > HALF) else block[MIDDLE + j]
                    weights[j], in_front[j] = weight, front_weight(t, weight, rules.stop_after)
            if not alone:
                for d in range(THREE, through):
                    add_scaled(floats_at(block, CHANNEL + LANES * d), weights, row[CHANNELS + d])
                for d in range(through, through + until):
                    add_scaled(floats_at(block, CHANNEL + LANES * d), in_front, row[CHANNELS + d])
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
    through = at_least_three(on)
    blocks, of_row, pixels = floats_on_stack(BLOCKS), blocks_of_row(side), side * side
    begin_blocks(blocks, side, through + in_front)
    for y in range(side):
        for x in range(side):
            floats_at(blocks, (y * of_row + x // LANES) * BLOCK)[LIGHT + x % LANES] = ONE
    if through == THREE and in_front == 0 and not with_median:
        blend_list(blocks, rows, splats, count, center_x, center_y, side, through, in_front, rules, True)
    else:
        blend_list(blocks, rows, splats, count, center_x, center_y, side, through, in_front, rules, False)
    for y in range(side):
        for x in range(side):
            p, block = y * side + x, floats_at(blocks, (y * of_row + x // LANES) * BLOCK + x % LANES)
            light[p], last[p], median[p] = abs(block[LIGHT]), np.int32(block[LATEST]), np.int32(block[MIDDLE])
            for d in range(on):
                features[d * pixels + p] = block[CHANNEL + LANES * d]
            for d in range(in_front):
                features[(on + d) * pixels + p] = block[CHANNEL + LANES * (through + d)]


@inlined
def unblend_list(blocks, rows, splats, count, center_x, center_y, side, through, until, rules, sums, alone):
    """Walks back over a list; `alone`, a literal: only three channels are there."""
    of_row, channels = blocks_of_row(side), through + until
    width, parts = CHANNELS + channels, floats_on_stack(PART_LANES)
    lit_more, lit_in_front = floats_on_stack(LANES), floats_on_stack(LANES)
    weights, in_front = floats_on_stack(LANES), floats_on_stack(LANES)
    for k in range(count - 1, -1, -1):
        row, total = floats_at(rows, splats[k] * width), floats_at(sums, splats[k] * width)
        x, y, xx, xy, yy, opacity = row[0] - center_x, row[1] - center_y, row[2], row[3], row[4], row[5]
        top, bottom = rows_reached(y + HALF * np.float32(side), row[REACH], side)
        r, g, b, place = row[CHANNELS], row[CHANNELS + 1], row[CHANNELS + 2], np.float32(k)
        for j in range((GEOMETRY + THREE if alone else GEOMETRY + channels) * LANES):
            parts[j] = ZERO
        for n in range(top * of_row, bottom * of_row):
            block = floats_at(blocks, n * BLOCK)
            if not alone:
                for j in range(LANES):
                    lit_more[j], lit_in_front[j] = ZERO, ZERO
                for d in range(THREE, through):
                    add_scaled(lit_more, floats_at(block, CHANNEL + LANES * d), row[CHANNELS + d])
                for d in range(through, channels):
                    add_scaled(lit_in_front, floats_at(block, CHANNEL + LANES * d), row[CHANNELS + d])
            for j in range(LANES):
                dx, dy = x - block[PIXEL_X + j], y - block[PIXEL_Y + j]
                unclamped = opacity * exp_minus(splat_sigma(dx, dy, xx, xy, yy))
                alpha = cut_alpha(unclamped, rules) if place <= block[LATEST + j] else ZERO
                d_r, d_g, d_b = block[CHANNEL + j], block[CHANNEL + LANES + j], block[CHANNEL + 2 * LANES + j]
                lit = r * d_r + g * d_g + b * d_b
                if alone:
                    d_sigma, weight, t, behind = unblend_splat(
                        block[LIGHT + j], block[BEHIND + j], lit, alpha, unclamped, rules
                    )
                else:
                    d_sigma, weight, t, behind = unblend_in_front(
                        block[LIGHT + j], block[BEHIND + j], lit + lit_more[j], alpha, unclamped, rules, lit_in_front[j]
                    )
                    weights[j], in_front[j] = weight, front_weight(t, weight, rules.stop_after)
                block[LIGHT + j], block[BEHIND + j] = t, behind
                along_x, along_y = d_sigma * dx, d_sigma * dy
                parts[j] += d_sigma
                parts[LANES + j] += along_x
                parts[2 * LANES + j] += along_y
                parts[3 * LANES + j] += along_x * dx
                parts[4 * LANES + j] += along_x * dy
                parts[5 * LANES + j] += along_y * dy
                parts[6 * LANES + j] += weight * d_r
                parts[7 * LANES + j] += weight * d_g
                parts[8 * LANES + j] += weight * d_b
            if not alone:
                for d in range(THREE, through):
                    add_products(
                        floats_at(parts, LANES * (GEOMETRY + d)), weights, floats_at(block, CHANNEL + LANES * d)
                    )
                for d in range(through, channels):
                    add_products(
                        floats_at(parts, LANES * (GEOMETRY + d)), in_front, floats_at(block, CHANNEL + LANES * d)
                    )
        for c in range(GEOMETRY):
            total[c] += sum_of_lanes(parts, LANES * c)
        for d in range(THREE if alone else channels):
            total[CHANNELS + d] += sum_of_lanes(parts, LANES * (GEOMETRY + d))


@inlined
def sum_of_lanes(parts, first):
    """The sum of a vector's numbers."""
    total = ZERO
    for j in range(LANES):
        total += parts[first + j]
    return total


@inlined
def unblend_tile(rows, splats, center_x, center_y, side, on, in_front, rules, light, last, d_features, d_light, sums):
    """Walks back over a tile's list, from the last splat that shows.

    Args:
        rows: As in `blend_tile`, and what is not named here.
        splats: The list.
        center_x: Of the tile.
        center_y: The same along y.
        side: Of the tile.
        on: Channels that are blended to the end.
        in_front: Channels that end in front.
        rules: `Thresholds`.
        light: `[P]`, as `blend_tile` wrote it.
        last: `[P]`, too.
        d_features: `[D, P]` dL/dfeatures.
        d_light: `[P]` dL/dlight.
        sums: Like `rows`, added to: moments of dL/dsigma about the splats' means, and dL/dchannels.
    """
    through = at_least_three(on)
    blocks, of_row, pixels, count = floats_on_stack(BLOCKS), blocks_of_row(side), side * side, 0
    begin_blocks(blocks, side, through + in_front)
    for y in range(side):
        for x in range(side):
            p, block = y * side + x, floats_at(blocks, (y * of_row + x // LANES) * BLOCK + x % LANES)
            block[LIGHT], block[BEHIND], block[LATEST] = light[p], light[p] * d_light[p], np.float32(last[p])
            count = max(count, last[p] + 1)
            for d in range(on):
                block[CHANNEL + LANES * d] = d_features[d * pixels + p]
            for d in range(in_front):
                block[CHANNEL + LANES * (through + d)] = d_features[(on + d) * pixels + p]
    if through == THREE and in_front == 0:
        unblend_list(blocks, rows, splats, count, center_x, center_y, side, through, in_front, rules, sums, True)
    else:
        unblend_list(blocks, rows, splats, count, center_x, center_y, side, through, in_front, rules, sums, False)
