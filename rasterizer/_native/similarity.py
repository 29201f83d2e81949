"""SSIM of two images and its gradient, as XLA calls them.

A thread takes a tile of both images with the border that the window reaches, on its stack: the images, the two products
whose means SSIM needs, and which pixels are valid. Window means are weighted sums along columns, four rows at a time,
then along rows. The sum of SSIM is one number a tile, so that it does not depend on the number of threads.
"""

import numpy as np

from rasterizer._native.blending import ONE, ZERO
from rasterizer._native.calls import (
    argument,
    argument_rows,
    data,
    finish,
    floats,
    length,
    only_introduces,
    result,
    result_rows,
    share,
)
from rasterizer._native.compiled import handler, inlined
from rasterizer._native.instructions import as_bytes, floats_at, floats_on_stack

MAX_IMAGE_CHANNELS, RADIUS = 3, 5  # channels of an image, pixels that the window reaches
TILE_ROWS, WIDTH = 32, 192  # rows of a tile and numbers of a row, without the border
FOUR = 4  # rows that are summed at a time: 14 rows are read once, not 44
HELD_ROWS, HELD_WIDTH = TILE_ROWS + 2 * RADIUS, WIDTH + 32  # with the border, a row in whole vectors
PLANE, FOUR_ROWS = HELD_ROWS * HELD_WIDTH, FOUR * HELD_WIDTH
# Planes of a tile: the images, the sum of their squares, their product, and 1 where a pixel is valid. On the way back:
# three slopes, and 1 where a pixel is valid.
_IMAGE, _TARGET, _SQUARES, _PRODUCT, _VALID = (PLANE * place for place in range(5))
_VALID_BACK = 3 * PLANE
PLANES, BACK_PLANES, BLURRED, MEANS = 5 * PLANE, 4 * PLANE, 4 * FOUR_ROWS, 4 * WIDTH

_exponentials = np.exp(-0.5 * (np.arange(RADIUS + 1) / 1.5) ** 2)
W0, W1, W2, W3, W4, W5 = (_exponentials / (2 * _exponentials.sum() - 1)).astype(np.float32)
C1, C2, TWO = np.float32(0.01**2), np.float32(0.03**2), np.float32(2)

# Of a frame: its arguments, and the results of `ssim`.
_IMAGES, _TARGETS, _MASK, _SLOPES, _SCALE = range(5)
_SUMS, _NEW_SLOPES = range(2)


@inlined
def weighted(s0, s1, s2, s3, s4, s5, s6, s7, s8, s9, s10):
    """Weighted sum of the eleven numbers in a window."""
    return W5 * (s0 + s10) + W4 * (s1 + s9) + W3 * (s2 + s8) + W2 * (s3 + s7) + W1 * (s4 + s6) + W0 * s5


@inlined
def blur_columns(target, source):
    """Four rows of weighted sums along columns, from 14 rows."""
    n = HELD_WIDTH
    for i in range(n):
        s0, s1, s2, s3, s4 = source[i], source[i + n], source[i + 2 * n], source[i + 3 * n], source[i + 4 * n]
        s5, s6, s7, s8 = source[i + 5 * n], source[i + 6 * n], source[i + 7 * n], source[i + 8 * n]
        s9, s10, s11, s12 = source[i + 9 * n], source[i + 10 * n], source[i + 11 * n], source[i + 12 * n]
        s13 = source[i + 13 * n]
        target[i] = weighted(s0, s1, s2, s3, s4, s5, s6, s7, s8, s9, s10)
        target[i + n] = weighted(s1, s2, s3, s4, s5, s6, s7, s8, s9, s10, s11)
        target[i + 2 * n] = weighted(s2, s3, s4, s5, s6, s7, s8, s9, s10, s11, s12)
        target[i + 3 * n] = weighted(s3, s4, s5, s6, s7, s8, s9, s10, s11, s12, s13)


@inlined
def blur_row(target, source, channels):
    """Weighted sums along a row of interleaved channels."""
    n = channels
    for i in range(WIDTH):
        s0, s1, s2, s3, s4 = source[i], source[i + n], source[i + 2 * n], source[i + 3 * n], source[i + 4 * n]
        s5, s6, s7, s8 = source[i + 5 * n], source[i + 6 * n], source[i + 7 * n], source[i + 8 * n]
        target[i] = weighted(s0, s1, s2, s3, s4, s5, s6, s7, s8, source[i + 9 * n], source[i + 10 * n])


@inlined
def means_of_row(means, blurred, planes, count, row, channels):
    """Window means about a row of a tile of so many planes; rows come in order, from 0."""
    if row % FOUR == 0:
        for plane in range(count):
            blur_columns(floats_at(blurred, plane * FOUR_ROWS), floats_at(planes, plane * PLANE + row * HELD_WIDTH))
    for plane in range(count):
        source = floats_at(blurred, plane * FOUR_ROWS + row % FOUR * HELD_WIDTH)
        blur_row(floats_at(means, plane * WIDTH), source, channels)


@inlined
def clear(numbers, count):
    """Sets so many numbers to zero."""
    for i in range(count):
        numbers[i] = ZERO


@inlined
def copy(target, source, count):
    """Copies so many numbers."""
    for i in range(count):
        target[i] = source[i]


@inlined
def shape_of(frame):
    """Height, width and channels of the images."""
    image = argument(frame, _IMAGES)
    return length(image, 0), length(image, 1), length(image, 2)


@inlined
def place_of_tile(frame, tile):
    """First row, end of the rows, first column and end of the columns of a tile."""
    height, width, channels = shape_of(frame)
    columns = WIDTH // channels
    across = (width + columns - 1) // columns
    top, left = tile // across * TILE_ROWS, tile % across * columns
    return top, min(top + TILE_ROWS, height), left, min(left + columns, width)


@inlined
def read_mask(valid, mask, columns, channels):
    """Writes 1 for each number of the valid pixels among `columns`; the rest stays."""
    count = 0
    for x in range(columns):
        count += mask[x]
    if count == columns:  # In most tiles. One number at a time would take longer than all else that is read.
        for i in range(columns * channels):
            valid[i] = ONE
    elif count > 0:
        for x in range(columns):
            for c in range(channels):
                valid[x * channels + c] = mask[x]


@inlined
def pixels_from(frame, place, channels):
    """The image and the target from a pixel on."""
    return argument_rows(frame, _IMAGES, place, channels), argument_rows(frame, _TARGETS, place, channels)


@inlined
def read_tile(frame, planes, tile):
    """The five planes of a tile with its border: zeros at invalid pixels, and beyond the images."""
    height, width, channels = shape_of(frame)
    top, end_row, left, end_column = place_of_tile(frame, tile)
    begin, end = max(left - RADIUS, 0), min(end_column + RADIUS, width)
    first, last = max(top - RADIUS, 0), min(end_row + RADIUS, height)
    inset = floats_at(planes, (begin - left + RADIUS) * channels - (top - RADIUS) * HELD_WIDTH)
    clear(planes, PLANES)
    # All rows before the next loop: a processor that reads what it has just written in smaller parts waits for it.
    for y in range(first, last):
        valid = floats_at(inset, _VALID + y * HELD_WIDTH)
        read_mask(valid, as_bytes(data(argument(frame, _MASK)) + y * width + begin), end - begin, channels)
    for y in range(first, last):
        place, row = y * width + begin, floats_at(inset, y * HELD_WIDTH)
        image, target = pixels_from(frame, place, channels)
        for i in range((end - begin) * channels):
            is_valid = row[_VALID + i] > ZERO
            a, b = image[i] if is_valid else ZERO, target[i] if is_valid else ZERO
            row[_IMAGE + i], row[_TARGET + i] = a, b
            row[_SQUARES + i], row[_PRODUCT + i] = a * a + b * b, a * b


@inlined
def compare(means, valid):
    """The sum of SSIM along a row; in the place of the means its slopes to mean, squares and product."""
    total = ZERO
    for i in range(WIDTH):
        x, y, squares, product = means[i], means[WIDTH + i], means[2 * WIDTH + i], means[3 * WIDTH + i]
        per_luminance, per_structure = ONE / (x * x + y * y + C1), ONE / (squares - (x * x + y * y) + C2)
        luminance, structure = (TWO * (x * y) + C1) * per_luminance, (TWO * (product - x * y) + C2) * per_structure
        of_luminance = structure * per_luminance * (y - luminance * x)
        of_structure = luminance * per_structure * (structure * x - y)
        total += valid[i] * (luminance * structure)
        means[i] = TWO * valid[i] * (of_luminance + of_structure)
        means[WIDTH + i] = -valid[i] * (luminance * structure * per_structure)
        means[2 * WIDTH + i] = TWO * valid[i] * (luminance * per_structure)
    return total


@inlined
def compare_tile(frame, tile):
    """Writes the sum of a tile's SSIM, and its slopes."""
    planes, blurred, means = floats_on_stack(PLANES), floats_on_stack(BLURRED), floats_on_stack(MEANS)
    (height, width, channels), total = shape_of(frame), ZERO
    top, end_row, left, end_column = place_of_tile(frame, tile)
    count = length(result(frame, _NEW_SLOPES), 0) + 1  # Of a literal LLVM would repeat the loops, and compile longer.
    read_tile(frame, planes, tile)
    for y in range(top, end_row):
        means_of_row(means, blurred, planes, count, y - top, channels)
        valid = floats_at(planes, _VALID + (y - top + RADIUS) * HELD_WIDTH + RADIUS * channels)
        total += compare(means, valid)
        for plane in range(3):
            slopes = result_rows(frame, _NEW_SLOPES, (plane * height + y) * width + left, channels)
            copy(slopes, floats_at(means, plane * WIDTH), (end_column - left) * channels)
    floats(result(frame, _SUMS))[tile] = total


@inlined
def read_slopes(frame, planes, tile):
    """The three planes of slopes of a tile with its border, and which of its pixels are valid."""
    height, width, channels = shape_of(frame)
    top, end_row, left, end_column = place_of_tile(frame, tile)
    begin, end = max(left - RADIUS, 0), min(end_column + RADIUS, width)
    inset = floats_at(planes, (begin - left + RADIUS) * channels - (top - RADIUS) * HELD_WIDTH)
    clear(planes, BACK_PLANES)
    for plane in range(3):
        for y in range(max(top - RADIUS, 0), min(end_row + RADIUS, height)):
            slopes = argument_rows(frame, _SLOPES, (plane * height + y) * width + begin, channels)
            copy(floats_at(inset, plane * PLANE + y * HELD_WIDTH), slopes, (end - begin) * channels)
    for y in range(top, end_row):
        valid = floats_at(planes, _VALID_BACK + (y - top) * HELD_WIDTH)
        read_mask(valid, as_bytes(data(argument(frame, _MASK)) + y * width + left), end_column - left, channels)


@inlined
def differentiate_tile(frame, tile):
    """Writes a tile's gradient to the image."""
    planes, blurred, means = floats_on_stack(BACK_PLANES), floats_on_stack(BLURRED), floats_on_stack(MEANS)
    (_, width, channels), scale = shape_of(frame), floats(argument(frame, _SCALE))[0]
    top, end_row, left, end_column = place_of_tile(frame, tile)
    count = length(argument(frame, _SLOPES), 0)  # As in `compare_tile`.
    read_slopes(frame, planes, tile)
    for y in range(top, end_row):
        means_of_row(means, blurred, planes, count, y - top, channels)
        valid = floats_at(planes, _VALID_BACK + (y - top) * HELD_WIDTH)
        place = y * width + left
        image, target = pixels_from(frame, place, channels)
        gradient = result_rows(frame, 0, place, channels)
        for i in range((end_column - left) * channels):
            slope = means[i] + TWO * image[i] * means[WIDTH + i] + target[i] * means[2 * WIDTH + i]
            gradient[i] = scale * slope if valid[i] > ZERO else ZERO


@inlined
def count_tiles(height, width, channels):
    """Tiles of an image."""
    columns = WIDTH // channels
    return ((height + TILE_ROWS - 1) // TILE_ROWS) * ((width + columns - 1) // columns)


@handler
def ssim(frame):
    """(image, target, mask) -> the sum of SSIM over the valid pixels of each tile, and the slopes."""
    if only_introduces(frame):
        return 0
    return finish(frame, share(frame, compare_tile, frame, count_tiles(*shape_of(frame))))


@handler
def ssim_gradient(frame):
    """(image, target, mask, slopes, cotangent of the sum) -> the gradient to the image."""
    if only_introduces(frame):
        return 0
    return finish(frame, share(frame, differentiate_tile, frame, count_tiles(*shape_of(frame))))
