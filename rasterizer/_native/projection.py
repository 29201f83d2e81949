"""The projection of Gaussians into pinhole cameras and its gradient, as XLA calls them.

A thread takes a block of Gaussians, and `LANES` of them at a time. Gradients are sums over the cameras in their order.
A Gaussian whose cotangents are zero, as those of one that does not show, has zero gradients.
"""

import math

import numpy as np

from rasterizer._native.blending import ONE, ZERO
from rasterizer._native.calls import argument, argument_rows, data, floats, length, map_rows, result, result_rows, size
from rasterizer._native.compiled import handler, inlined
from rasterizer._native.ewa import (
    Lens,
    axes_gradient,
    center_of,
    conic_of,
    covariance_gradient,
    gaussian_of,
    mean_gradient,
    plus,
    quat_gradient,
    see,
    tilt_gradient,
    tilt_of,
)
from rasterizer._native.instructions import as_bytes, floats_on_stack
from rasterizer._native.vectors import LANES, broadcast, floor, load, square_root, store, where

BLOCK = 512  # Gaussians that a thread takes at a time
MARGIN = np.float32(0.15)  # of the image, by which the affine approximation is taken beyond it
HALF = np.float32(0.5)

# Of a frame: its arguments, with cotangents from `_TO_MEANS2D` on; results of `project`; results with gradients.
_MEANS, _QUATS, _SCALES, _OPACITIES, _VIEWMATS, _KS, _OPTIONS = range(7)
_TO_MEANS2D, _TO_DEPTHS, _TO_CONICS, _TO_COMPENSATIONS, _TO_SLOPES = range(7, 12)
_MEANS2D, _DEPTHS, _CONICS, _COMPENSATIONS, _SLOPES, _EXTENTS, _VISIBLE = range(7)
_D_MEANS, _D_QUATS, _D_SCALES = range(3)
# Of the options, float32: the image's size, `project`'s numbers, `Rules`', and whether compensations and slopes are
# computed and extents shrink.
_WIDTH, _HEIGHT, _EPS2D, _NEAR, _FAR, _RADIUS_CLIP, _ALPHA_MIN, _COMPENSATION_MIN, _SIGMAS = range(9)
_ANTIALIASED, _PLANE, _SHRINKS = 9, 10, 11


@inlined
def column(rows, width, place, count):
    """The vector of one number of each row; zeros past the last row."""
    lanes = floats_on_stack(LANES)
    for i in range(LANES):
        lanes[i] = rows[i * width + place] if i < count else ZERO
    return load(lanes)


@inlined
def columns_of_three(frame, place, row, count):
    """Three vectors of an argument, from a row on."""
    rows = argument_rows(frame, place, row, 3)
    return column(rows, 3, 0, count), column(rows, 3, 1, count), column(rows, 3, 2, count)


@inlined
def columns_of_two(frame, place, row, count):
    """Two vectors of an argument, from a row on."""
    rows = argument_rows(frame, place, row, 2)
    return column(rows, 2, 0, count), column(rows, 2, 1, count)


@inlined
def set_columns(frame, place, row, count, vectors):
    """Writes all numbers of each row of a result, from a row on."""
    width = len(vectors)
    rows, lanes = result_rows(frame, place, row, width), floats_on_stack(LANES)
    for number in range(width):
        store(lanes, vectors[number])
        for i in range(count):
            rows[i * width + number] = lanes[i]


@inlined
def options_of(frame):
    """The numbers of the options."""
    return floats(argument(frame, _OPTIONS))


@inlined
def count_rows(frame):
    """Gaussians."""
    return length(argument(frame, _MEANS), 0)


@inlined
def lens_of(frame, camera):
    """A camera's `Lens`."""
    v, k = argument_rows(frame, _VIEWMATS, camera, 16), argument_rows(frame, _KS, camera, 9)
    options = options_of(frame)
    fx, fy, cx, cy = k[0], k[4], k[2], k[5]
    width, height = options[_WIDTH], options[_HEIGHT]
    return Lens(
        ((v[0], v[1], v[2]), (v[4], v[5], v[6]), (v[8], v[9], v[10])),
        (v[3], v[7], v[11]),
        (fx, fy),
        (cx, cy),
        (-cx / fx - MARGIN * width / fx, -cy / fy - MARGIN * height / fy),
        ((width - cx) / fx + MARGIN * width / fx, (height - cy) / fy + MARGIN * height / fy),
        options[_EPS2D],
        options[_NEAR],
        options[_FAR],
    )


@inlined
def gaussians_at(frame, first, count):
    """The Gaussians from a row on."""
    quats = argument_rows(frame, _QUATS, first, 4)
    w, x = column(quats, 4, 0, count), column(quats, 4, 1, count)
    y, z = column(quats, 4, 2, count), column(quats, 4, 3, count)
    mean, scales = columns_of_three(frame, _MEANS, first, count), columns_of_three(frame, _SCALES, first, count)
    return gaussian_of(mean, (w, x, y, z), scales)


@inlined
def is_usable(frame, g, view, lens, opacity):
    """Where a Gaussian is in front, not too faint, and nothing of it overflows or is NaN."""
    center, conic, (xx, _, yy) = center_of(view, lens), conic_of(view), view.variances
    # Zero times a number that is not finite is NaN.
    total = ZERO * view.det + ZERO * opacity + ZERO * (xx + yy) + ZERO * (center[0] + center[1])
    total = total + ZERO * conic[0] + ZERO * conic[1] + ZERO * conic[2]
    if options_of(frame)[_PLANE] > ZERO:
        tilt = tilt_of(g, view, lens)
        total = total + ZERO * (tilt.steep[0] * tilt.flatter) + ZERO * (tilt.steep[1] * tilt.flatter)
    z = view.depth
    usable = (z > lens.near) & (z < lens.far) & (view.det > ZERO) & (xx > ZERO) & (yy > ZERO)
    return usable & (opacity >= broadcast(options_of(frame)[_ALPHA_MIN])) & (total == ZERO)


@inlined
def compensation_of(view, least):
    """The factor of the opacity that undoes the blur, and whether it is above the least one."""
    ratio = view.sharp / view.det
    above = ratio > broadcast(least * least)
    return where(above, square_root(where(above, ratio, ONE)), least), above


@inlined
def sigmas_of(frame, opacity):
    """The standard deviations up to which a splat can pass the alpha cut."""
    options, lanes = options_of(frame), floats_on_stack(LANES)
    store(lanes, opacity)
    for i in range(LANES):
        sigmas = options[_SIGMAS]
        if options[_SHRINKS] > ZERO:
            # Alpha falls to its cut where exp(-s^2 / 2) = cut / opacity.
            sigmas = min(sigmas, np.float32(math.sqrt(2 * math.log(max(lanes[i] / options[_ALPHA_MIN], ONE)))))
        lanes[i] = sigmas
    return load(lanes)


@inlined
def project_some(frame, first, count):
    """Projects the Gaussians from a row on into all cameras."""
    for camera in range(length(argument(frame, _VIEWMATS), 0)):
        project_into(frame, camera, first, count)


@inlined
def project_into(frame, camera, first, count):
    """Projects the Gaussians from a row on into a camera."""
    lens, options, row = lens_of(frame, camera), options_of(frame), camera * count_rows(frame) + first
    g, opacity = gaussians_at(frame, first, count), column(argument_rows(frame, _OPACITIES, first, 1), 1, 0, count)
    view = see(g, lens)
    usable = is_usable(frame, g, view, lens, opacity)
    if options[_ANTIALIASED] > ZERO:
        factor, _ = compensation_of(view, options[_COMPENSATION_MIN])
        opacity = opacity * factor
        set_columns(frame, _COMPENSATIONS, row, count, (where(usable, factor, ONE),))
    if options[_PLANE] > ZERO:
        tilt = tilt_of(g, view, lens)
        steep_x, steep_y = tilt.steep[0] * tilt.flatter, tilt.steep[1] * tilt.flatter
        set_columns(frame, _SLOPES, row, count, (where(usable, steep_x, ZERO), where(usable, steep_y, ZERO)))
    (x, y), conic = center_of(view, lens), conic_of(view)
    x, y = where(usable, x, lens.center[0]), where(usable, y, lens.center[1])
    set_columns(frame, _MEANS2D, row, count, (x, y))
    set_columns(frame, _DEPTHS, row, count, (where(usable, view.depth, ONE),))
    conic = where(usable, conic[0], ONE), where(usable, conic[1], ZERO), where(usable, conic[2], ONE)
    set_columns(frame, _CONICS, row, count, conic)
    usable = usable & (opacity >= broadcast(options[_ALPHA_MIN]))
    sigmas, (xx, _, yy) = sigmas_of(frame, where(usable, opacity, ONE)), view.variances
    set_extents(frame, row, count, usable, (x, y), (sigmas * square_root(xx), sigmas * square_root(yy)))


@inlined
def set_extents(frame, row, count, usable, center, reach):
    """Writes which splats are visible, and their extents."""
    options = options_of(frame)
    radius_x, radius_y = -floor(-reach[0]), -floor(-reach[1])  # Whole pixels, as gsplat's are.
    visible = usable & (center[0] + radius_x > ZERO) & (center[0] - radius_x < options[_WIDTH])
    visible = visible & (center[1] + radius_y > ZERO) & (center[1] - radius_y < options[_HEIGHT])
    if options[_RADIUS_CLIP] > ZERO:
        visible = visible & ((radius_x > options[_RADIUS_CLIP]) | (radius_y > options[_RADIUS_CLIP]))
    extents = where(visible, reach[0], ZERO), where(visible, reach[1], ZERO)
    set_columns(frame, _EXTENTS, row, count, extents)
    lanes, flags = floats_on_stack(LANES), as_bytes(data(result(frame, _VISIBLE)) + row)
    store(lanes, where(visible, ONE, broadcast(ZERO)))
    for i in range(count):
        flags[i] = lanes[i] > ZERO


@inlined
def gradient_in_view(frame, camera, first, count, g, opacity):
    """Gradients to mean, quaternion and scales of the Gaussians from a row on, as one camera sees them."""
    lens, options, row = lens_of(frame, camera), options_of(frame), camera * count_rows(frame) + first
    view, nothing = see(g, lens), broadcast(ZERO)
    center, conic = columns_of_two(frame, _TO_MEANS2D, row, count), columns_of_three(frame, _TO_CONICS, row, count)
    depth, to_det, to_sharp = column(argument_rows(frame, _TO_DEPTHS, row, 1), 1, 0, count), nothing, nothing
    to_x, to_y, to_z = (nothing, nothing, nothing), (nothing, nothing, nothing), (nothing, nothing, nothing)
    if options[_PLANE] > ZERO:
        slopes = columns_of_two(frame, _TO_SLOPES, row, count)
        to_x, to_y, to_z, to_det, to_depth = tilt_gradient(tilt_of(g, view, lens), view, lens, slopes)
        depth = depth + to_depth
    if options[_ANTIALIASED] > ZERO:
        factor, above = compensation_of(view, options[_COMPENSATION_MIN])
        to_factor = column(argument_rows(frame, _TO_COMPENSATIONS, row, 1), 1, 0, count)
        to_ratio = where(above, HALF * to_factor / factor, ZERO) / view.det
        to_sharp, to_det = to_sharp + to_ratio, to_det - to_ratio * factor * factor
    more_x, more_y = covariance_gradient(view, lens, conic, to_det, to_sharp)
    to_axes, to_scales, to_row_x, to_row_y = axes_gradient(g, view, lens, plus(to_x, more_x), plus(to_y, more_y), to_z)
    to_mean = mean_gradient(view, lens, center, depth, to_row_x, to_row_y)
    usable, to_quat = is_usable(frame, g, view, lens, opacity), quat_gradient(g, to_axes)
    (x, y, z), w = where_three(usable, to_quat[1:]), where(usable, to_quat[0], ZERO)
    return where_three(usable, to_mean), (w, x, y, z), where_three(usable, to_scales)


@inlined
def where_three(mask, vectors):
    """Three vectors, and zero where the mask does not hold."""
    return where(mask, vectors[0], ZERO), where(mask, vectors[1], ZERO), where(mask, vectors[2], ZERO)


@inlined
def is_pulled(frame, camera, first, count):
    """Whether a cotangent of the Gaussians from a row on is not zero."""
    row = camera * count_rows(frame) + first
    for place, width in ((_TO_MEANS2D, 2), (_TO_DEPTHS, 1), (_TO_CONICS, 3), (_TO_COMPENSATIONS, 1), (_TO_SLOPES, 2)):
        if size(argument(frame, place)) > 0:
            cotangents = argument_rows(frame, place, row, width)
            for i in range(count * width):
                if cotangents[i] != ZERO:
                    return True
    return False


@inlined
def differentiate_some(frame, first, count):
    """Writes the gradients of the Gaussians from a row on."""
    g, opacity = gaussians_at(frame, first, count), column(argument_rows(frame, _OPACITIES, first, 1), 1, 0, count)
    nothing = broadcast(ZERO)
    to_mean, to_scales = (nothing, nothing, nothing), (nothing, nothing, nothing)
    w, to_axis = nothing, (nothing, nothing, nothing)
    for camera in range(length(argument(frame, _VIEWMATS), 0)):
        if is_pulled(frame, camera, first, count):
            mean, quat, scales = gradient_in_view(frame, camera, first, count, g, opacity)
            to_mean, to_scales = plus(to_mean, mean), plus(to_scales, scales)
            w, to_axis = w + quat[0], plus(to_axis, quat[1:])
    set_columns(frame, _D_MEANS, first, count, to_mean)
    set_columns(frame, _D_SCALES, first, count, to_scales)
    set_columns(frame, _D_QUATS, first, count, (w, to_axis[0], to_axis[1], to_axis[2]))


@handler
def project(frame):
    """(means, quats, scales, opacities, viewmats, Ks, options) -> the fields of `Projection`, from `means2d` on."""
    return map_rows(frame, project_some, 3, BLOCK, LANES)


@handler
def project_gradient(frame):
    """(the same, cotangents of means2d, depths, conics, compensations, slopes) -> of means, quats and scales.

    A cotangent without numbers is zero.
    """
    return map_rows(frame, differentiate_some, 3, BLOCK, LANES)
