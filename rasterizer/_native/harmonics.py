"""Spherical harmonics of degree 1 to 3 and their gradients, as XLA calls them.

A thread takes a block of rows. Basis functions are computed for a strip of rows at a time, in vectors; the coefficients
of a row, which lie next to each other, are then read once. A row whose cotangent is zero, as that of a Gaussian that
does not show, has zero gradients and is not read.
"""

import numpy as np

from rasterizer._native.blending import ONE, ZERO
from rasterizer._native.calls import argument, argument_rows, floats, length, map_rows, result_rows
from rasterizer._native.compiled import handler, inlined
from rasterizer._native.instructions import floats_at, floats_on_stack
from rasterizer._native.vectors import LANES, absolute, larger, load, square_root, store, where

BLOCK, STRIP = 512, 32  # rows that a thread takes at a time, and those whose basis functions it holds
BANDS = {3, 8, 15}  # numbers of the basis functions of degree 1 to 3, and all below
CHANNELS = 3
BASIS_NUMBERS = 15 * STRIP
# Of a strip: unit directions and the inverses of their lengths.
_X, _Y, _Z, _INVERSE = (STRIP * place for place in range(4))
DIRECTIONS = 4 * STRIP
TINY = np.finfo(np.float32).tiny
# Factors of the basis functions, in the order of `rasterizer.harmonics`.
F1 = np.float32(0.48860251190291992)
F20, F21, F22 = map(np.float32, (1.0925484305920790, 0.31539156525252000, 0.54627421529603950))
F30, F31, F32, F33, F34 = map(
    np.float32,
    (0.59004358992664350, 2.8906114426405540, 0.45704579946446570, 0.37317633259011540, 1.4453057213202770),
)
TWO, THREE, FOUR, SIX, EIGHT = map(np.float32, (2, 3, 4, 6, 8))

# Of a frame: its arguments, and its results with gradients.
_DIRS, _COEFFS, _WEIGHTS, _COTANGENTS = range(4)
_D_DIRS, _D_COEFFS = range(2)


@inlined
def read_directions(strip, dirs, count):
    """Writes unit directions and inverse lengths: of a zero direction +z and 0, as of rows past the last."""
    for i in range(STRIP):
        strip[_X + i] = dirs[3 * i] if i < count else ZERO
        strip[_Y + i] = dirs[3 * i + 1] if i < count else ZERO
        strip[_Z + i] = dirs[3 * i + 2] if i < count else ZERO
    for i in range(0, STRIP, LANES):
        x, y, z = load(floats_at(strip, _X + i)), load(floats_at(strip, _Y + i)), load(floats_at(strip, _Z + i))
        # Divided by the largest entry first: the squares of a very long or short direction would overflow or vanish.
        largest = larger(larger(absolute(x), absolute(y)), absolute(z))
        is_zero = largest < TINY
        safe = where(is_zero, ONE, largest)
        x, y, z = where(is_zero, ZERO, x / safe), where(is_zero, ZERO, y / safe), where(is_zero, ONE, z / safe)
        inverse = ONE / square_root(x * x + y * y + z * z)
        store(floats_at(strip, _X + i), x * inverse)
        store(floats_at(strip, _Y + i), y * inverse)
        store(floats_at(strip, _Z + i), z * inverse)
        store(floats_at(strip, _INVERSE + i), where(is_zero, ZERO, inverse / safe))


@inlined
def evaluate_basis(basis, strip, bands):
    """Writes the basis functions of a strip, a row of `STRIP` numbers each."""
    for i in range(0, STRIP, LANES):
        x, y, z = load(floats_at(strip, _X + i)), load(floats_at(strip, _Y + i)), load(floats_at(strip, _Z + i))
        at = floats_at(basis, i)
        store(floats_at(at, 0 * STRIP), -F1 * y)
        store(floats_at(at, 1 * STRIP), F1 * z)
        store(floats_at(at, 2 * STRIP), -F1 * x)
        if bands > 3:
            xx, yy, zz = x * x, y * y, z * z
            store(floats_at(at, 3 * STRIP), F20 * (x * y))
            store(floats_at(at, 4 * STRIP), -F20 * (y * z))
            store(floats_at(at, 5 * STRIP), F21 * (TWO * zz - xx - yy))
            store(floats_at(at, 6 * STRIP), -F20 * (x * z))
            store(floats_at(at, 7 * STRIP), F22 * (xx - yy))
            if bands > 8:
                store(floats_at(at, 8 * STRIP), -F30 * y * (THREE * xx - yy))
                store(floats_at(at, 9 * STRIP), F31 * (x * y) * z)
                store(floats_at(at, 10 * STRIP), -F32 * y * (FOUR * zz - xx - yy))
                store(floats_at(at, 11 * STRIP), F33 * z * (TWO * zz - THREE * (xx + yy)))
                store(floats_at(at, 12 * STRIP), -F32 * x * (FOUR * zz - xx - yy))
                store(floats_at(at, 13 * STRIP), F34 * z * (xx - yy))
                store(floats_at(at, 14 * STRIP), -F30 * x * (xx - THREE * yy))


@inlined
def slopes_of_degree_2(s, x, y, z):
    """What the basis functions of degree 1 and 2 add to the gradient to the unit direction."""
    s3, s4, s5 = load(floats_at(s, 3 * STRIP)), load(floats_at(s, 4 * STRIP)), load(floats_at(s, 5 * STRIP))
    s6, s7 = load(floats_at(s, 6 * STRIP)), load(floats_at(s, 7 * STRIP))
    gx = F20 * (s3 * y - s6 * z) - TWO * x * (F21 * s5 - F22 * s7)
    gy = F20 * (s3 * x - s4 * z) - TWO * y * (F21 * s5 + F22 * s7)
    gz = FOUR * F21 * (z * s5) - F20 * (s4 * y + s6 * x)
    return gx, gy, gz


@inlined
def slopes_of_degree_3(s, x, y, z):
    """What the basis functions of degree 3 add to it."""
    s8, s9, s10 = load(floats_at(s, 8 * STRIP)), load(floats_at(s, 9 * STRIP)), load(floats_at(s, 10 * STRIP))
    s11, s12, s13 = load(floats_at(s, 11 * STRIP)), load(floats_at(s, 12 * STRIP)), load(floats_at(s, 13 * STRIP))
    s14 = load(floats_at(s, 14 * STRIP))
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    gx = F31 * (yz * s9) - SIX * F30 * (xy * s8) + TWO * F32 * (xy * s10) - SIX * F33 * (xz * s11)
    gx = gx - F32 * (s12 * (FOUR * zz - THREE * xx - yy)) + TWO * F34 * (xz * s13) - THREE * F30 * (s14 * (xx - yy))
    gy = F31 * (xz * s9) - THREE * F30 * (s8 * (xx - yy)) - F32 * (s10 * (FOUR * zz - xx - THREE * yy))
    gy = gy - SIX * F33 * (yz * s11) + TWO * F32 * (xy * s12) - TWO * F34 * (yz * s13) + SIX * F30 * (xy * s14)
    gz = F31 * (xy * s9) - EIGHT * F32 * (yz * s10 + xz * s12) + F33 * (s11 * (SIX * zz - THREE * (xx + yy)))
    gz = gz + F34 * (s13 * (xx - yy))
    return gx, gy, gz


@inlined
def differentiate_directions(strip, slopes, bands):
    """Writes the gradient to the directions of a strip in their place, given that to its basis functions."""
    for i in range(0, STRIP, LANES):
        x, y, z = load(floats_at(strip, _X + i)), load(floats_at(strip, _Y + i)), load(floats_at(strip, _Z + i))
        s = floats_at(slopes, i)
        gx, gy, gz = -F1 * load(floats_at(s, 2 * STRIP)), -F1 * load(s), F1 * load(floats_at(s, STRIP))
        if bands > 3:
            ax, ay, az = slopes_of_degree_2(s, x, y, z)
            gx, gy, gz = gx + ax, gy + ay, gz + az
        if bands > 8:
            ax, ay, az = slopes_of_degree_3(s, x, y, z)
            gx, gy, gz = gx + ax, gy + ay, gz + az
        along, inverse = gx * x + gy * y + gz * z, load(floats_at(strip, _INVERSE + i))
        store(floats_at(strip, _X + i), inverse * (gx - along * x))
        store(floats_at(strip, _Y + i), inverse * (gy - along * y))
        store(floats_at(strip, _Z + i), inverse * (gz - along * z))


@inlined
def sum_row(values, coeffs, basis, weights, bands):
    """Writes the three values of a row."""
    r, g, b = ZERO, ZERO, ZERO
    for k in range(bands):
        factor = basis[k * STRIP] * weights[k]
        r += factor * coeffs[3 * k]
        g += factor * coeffs[3 * k + 1]
        b += factor * coeffs[3 * k + 2]
    values[0], values[1], values[2] = r, g, b


@inlined
def differentiate_row(d_coeffs, slopes, cotangents, coeffs, basis, weights, bands):
    """Writes the gradients of a row to its coefficients and to its basis functions."""
    r, g, b = cotangents[0], cotangents[1], cotangents[2]
    if r == ZERO and g == ZERO and b == ZERO:
        for i in range(CHANNELS * bands):
            d_coeffs[i] = ZERO
        for k in range(bands):
            slopes[k * STRIP] = ZERO
    else:
        for k in range(bands):
            factor = basis[k * STRIP] * weights[k]
            d_coeffs[3 * k], d_coeffs[3 * k + 1], d_coeffs[3 * k + 2] = factor * r, factor * g, factor * b
            slopes[k * STRIP] = weights[k] * (r * coeffs[3 * k] + g * coeffs[3 * k + 1] + b * coeffs[3 * k + 2])


@inlined
def bands_of(frame):
    """Coefficients of a row."""
    return length(argument(frame, _COEFFS), 1)


@inlined
def weights_of(frame, first, bands):
    """The weights from a row on, and how far those of the next row are: 0 where all rows have the same."""
    weights = argument(frame, _WEIGHTS)
    step = bands if length(weights, 0) > 1 else 0
    return floats_at(floats(weights), first * step), step


@inlined
def evaluate_strip(frame, first, count):
    """Writes the values of a strip of rows."""
    strip, basis, bands = floats_on_stack(DIRECTIONS), floats_on_stack(BASIS_NUMBERS), bands_of(frame)
    read_directions(strip, argument_rows(frame, _DIRS, first, 3), count)
    evaluate_basis(basis, strip, bands)
    values, width = result_rows(frame, 0, first, CHANNELS), CHANNELS * bands
    coeffs, (weights, step) = argument_rows(frame, _COEFFS, first, width), weights_of(frame, first, bands)
    for i in range(count):
        value, coefficients = floats_at(values, i * CHANNELS), floats_at(coeffs, i * width)
        sum_row(value, coefficients, floats_at(basis, i), floats_at(weights, i * step), bands)


@inlined
def differentiate_strip(frame, first, count):
    """Writes the gradients of a strip of rows."""
    strip, basis, slopes = floats_on_stack(DIRECTIONS), floats_on_stack(BASIS_NUMBERS), floats_on_stack(BASIS_NUMBERS)
    bands = bands_of(frame)
    read_directions(strip, argument_rows(frame, _DIRS, first, 3), count)
    evaluate_basis(basis, strip, bands)
    width, cotangents = CHANNELS * bands, argument_rows(frame, _COTANGENTS, first, CHANNELS)
    coeffs, d_coeffs = argument_rows(frame, _COEFFS, first, width), result_rows(frame, _D_COEFFS, first, width)
    weights, step = weights_of(frame, first, bands)
    for i in range(count):
        differentiate_row(
            floats_at(d_coeffs, i * width),
            floats_at(slopes, i),
            floats_at(cotangents, i * CHANNELS),
            floats_at(coeffs, i * width),
            floats_at(basis, i),
            floats_at(weights, i * step),
            bands,
        )
    differentiate_directions(strip, slopes, bands)
    d_dirs = result_rows(frame, _D_DIRS, first, 3)
    for i in range(count):
        d_dirs[3 * i], d_dirs[3 * i + 1], d_dirs[3 * i + 2] = strip[_X + i], strip[_Y + i], strip[_Z + i]


@handler
def upper_bands(frame):
    """(directions, coefficients, weights) -> values."""
    return map_rows(frame, evaluate_strip, 3, BLOCK, STRIP)


@handler
def upper_bands_gradient(frame):
    """(directions, coefficients, weights, cotangents of the values) -> gradients to directions and coefficients."""
    return map_rows(frame, differentiate_strip, 3, BLOCK, STRIP)
