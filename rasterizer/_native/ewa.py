"""The text of `rasterizer.projection` a second time, of vectors of Gaussians, and its derivative written by hand.

It is for Gaussians of axes and pinhole cameras. A point or a row is a tuple of three vectors or numbers.
"""

from typing import NamedTuple

import numpy as np

from rasterizer._native.blending import HALF, ONE, ZERO
from rasterizer._native.compiled import inlined
from rasterizer._native.vectors import absolute, larger, smaller, square_root, where
from rasterizer.ewa import SHOWN_SIGMAS

TWO = np.float32(2)
REACH = np.float32(SHOWN_SIGMAS**2)
ZERO_QUAT = np.float32(1e-12)


class Lens(NamedTuple):
    """A camera and the options of the projection, numbers."""

    rotation: tuple  # three rows
    translation: tuple
    focal: tuple  # x, y, as all below, pixels
    center: tuple
    least: tuple  # slopes at which the affine approximation is taken, at least and at most
    most: tuple
    eps2d: np.float32
    near: np.float32
    far: np.float32


class Gaussian(NamedTuple):
    """What a projection reads of Gaussians, vectors."""

    mean: tuple
    quat: tuple  # unit
    inverse: object  # of the quaternion's length; 0 where it is zero
    scales: tuple
    axes: tuple  # three columns of the rotation


class InView(NamedTuple):
    """A Gaussian in the image, and what its derivative needs, vectors."""

    depth: object
    point: tuple  # in the camera's frame; one unit away where it is not in front
    slope: tuple  # x / z, y / z, within what the approximation allows
    zoom: tuple  # pixels per scene unit
    rows: tuple  # of J W
    x: tuple  # the rows along the scaled axes
    y: tuple
    normal: tuple  # their cross product
    variances: tuple  # xx, xy, yy, blurred
    sharp: object  # determinant without blur
    det: object
    inverse_root: object  # of the determinant


class Tilt(NamedTuple):
    """How depth changes over a Gaussian's image, vectors."""

    z: tuple  # the camera's third row along the scaled axes
    xz: object  # covariances of image and depth
    yz: object
    steep: tuple  # slopes of the plane
    flatter: object  # factor that keeps it within reach
    reach_squared: object


@inlined
def dot(a, b):
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a, b):
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def times(factor, a):
    """A multiple."""
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def plus(a, b):
    """A sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def products(a, b):
    """Products of entries."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@inlined
def along(row, columns):
    """A row times a matrix of columns."""
    return dot(row, columns[0]), dot(row, columns[1]), dot(row, columns[2])


@inlined
def combination(factors, vectors):
    """The sum of three multiples."""
    return plus(plus(times(factors[0], vectors[0]), times(factors[1], vectors[1])), times(factors[2], vectors[2]))


@inlined
def gaussian_of(mean, quat, scales):
    """A `Gaussian`. A zero quaternion is the identity."""
    w, x, y, z = quat
    largest = larger(larger(absolute(w), absolute(x)), larger(absolute(y), absolute(z)))
    is_zero = largest < ZERO_QUAT
    safe = where(is_zero, ONE, largest)
    # The largest of numbers and NaN may be a number: what is NaN stays so, w too.
    w, x, y, z = where(is_zero, ONE + ZERO * w, w / safe), x / safe, y / safe, z / safe
    inverse = ONE / square_root(w * w + x * x + y * y + z * z)
    w, x, y, z = w * inverse, x * inverse, y * inverse, z * inverse
    columns = (
        (ONE - TWO * (y * y + z * z), TWO * (x * y + w * z), TWO * (x * z - w * y)),
        (TWO * (x * y - w * z), ONE - TWO * (x * x + z * z), TWO * (y * z + w * x)),
        (TWO * (x * z + w * y), TWO * (y * z - w * x), ONE - TWO * (x * x + y * y)),
    )
    return Gaussian(mean, (w, x, y, z), where(is_zero, ZERO, inverse / safe), scales, columns)


@inlined
def see(g, lens):
    """An `InView`. Where a Gaussian is not in front, or overflows, its numbers mean nothing."""
    turn = lens.rotation
    point = plus((dot(turn[0], g.mean), dot(turn[1], g.mean), dot(turn[2], g.mean)), lens.translation)
    safe = where(point[2] > lens.near, point[2], ONE)
    slope_x = smaller(larger(point[0] / safe, lens.least[0]), lens.most[0])
    slope_y = smaller(larger(point[1] / safe, lens.least[1]), lens.most[1])
    zoom_x, zoom_y = lens.focal[0] / safe, lens.focal[1] / safe
    row_x = times(zoom_x, plus(turn[0], times(-slope_x, turn[2])))
    row_y = times(zoom_y, plus(turn[1], times(-slope_y, turn[2])))
    x, y = products(along(row_x, g.axes), g.scales), products(along(row_y, g.axes), g.scales)
    normal = cross(x, y)
    xx, xy, yy, sharp = dot(x, x), dot(x, y), dot(y, y), dot(normal, normal)
    det = sharp + lens.eps2d * (xx + yy) + lens.eps2d * lens.eps2d
    inverse_root = ONE / square_root(where(det > ZERO, det, ONE))
    variances = xx + lens.eps2d, xy, yy + lens.eps2d
    depth, point = point[2], (point[0], point[1], safe)
    slope, zoom, rows = (slope_x, slope_y), (zoom_x, zoom_y), (row_x, row_y)
    return InView(depth, point, slope, zoom, rows, x, y, normal, variances, sharp, det, inverse_root)


@inlined
def center_of(view, lens):
    """The mean in the image."""
    x, y, z = view.point
    return lens.focal[0] * x / z + lens.center[0], lens.focal[1] * y / z + lens.center[1]


@inlined
def conic_of(view):
    """The inverse covariance in the image: divided by the root of the determinant twice, as nothing overflows then."""
    xx, xy, yy = view.variances
    root = view.inverse_root
    return yy * root * root, -xy * root * root, xx * root * root


@inlined
def tilt_of(g, view, lens):
    """A `Tilt`."""
    z = products(along(lens.rotation[2], g.axes), g.scales)
    xz, yz, root = dot(view.x, z), dot(view.y, z), view.inverse_root
    steep_x = (dot(view.normal, cross(z, view.y)) + lens.eps2d * xz) * root * root
    steep_y = (dot(view.normal, cross(view.x, z)) + lens.eps2d * yz) * root * root
    reach_squared, room = REACH * (steep_x * xz + steep_y * yz), view.point[2] - lens.near
    beyond = reach_squared > room * room
    flatter = where(beyond, room / square_root(where(beyond, reach_squared, ONE)), ONE)
    return Tilt(z, xz, yz, (steep_x, steep_y), flatter, where(beyond, reach_squared, ZERO))


@inlined
def tilt_gradient(tilt, view, lens, slopes):
    """Given that to the slopes, the gradients to x, y, z, the determinant and the depth."""
    through = slopes[0] * tilt.steep[0] + slopes[1] * tilt.steep[1]
    beyond = tilt.reach_squared > ZERO
    safe = where(beyond, tilt.reach_squared, ONE)
    to_depth = where(beyond, through / square_root(safe), ZERO)
    to_reach = where(beyond, -HALF * REACH * through * tilt.flatter / safe, ZERO)
    steep_x = slopes[0] * tilt.flatter + to_reach * tilt.xz
    steep_y = slopes[1] * tilt.flatter + to_reach * tilt.yz
    root = view.inverse_root
    to_det = -(steep_x * tilt.steep[0] + steep_y * tilt.steep[1]) * root * root
    of_x, of_y = steep_x * root * root, steep_y * root * root
    to_xz = to_reach * tilt.steep[0] + lens.eps2d * of_x
    to_yz = to_reach * tilt.steep[1] + lens.eps2d * of_y
    x, y, z, normal = view.x, view.y, tilt.z, view.normal
    to_normal = plus(times(of_x, cross(z, y)), times(of_y, cross(x, z)))
    to_x = plus(plus(times(of_y, cross(z, normal)), times(to_xz, z)), cross(y, to_normal))
    to_y = plus(plus(times(of_x, cross(normal, z)), times(to_yz, z)), cross(to_normal, x))
    to_z = plus(times(of_x, cross(y, normal)), times(of_y, cross(normal, x)))
    to_z = plus(to_z, plus(times(to_xz, x), times(to_yz, y)))
    return to_x, to_y, to_z, to_det, to_depth


@inlined
def covariance_gradient(view, lens, conic, to_det, to_sharp):
    """Given that to the conic and both determinants, the gradients to x and y."""
    xx, xy, yy = conic_of(view)
    root = view.inverse_root
    to_det = to_det - (conic[0] * xx + conic[1] * xy + conic[2] * yy) * root * root
    to_xx = TWO * (conic[2] * root * root + lens.eps2d * to_det)
    to_yy = TWO * (conic[0] * root * root + lens.eps2d * to_det)
    to_xy = -conic[1] * root * root
    to_normal = times(TWO * (to_sharp + to_det), view.normal)
    to_x = plus(plus(times(to_xx, view.x), times(to_xy, view.y)), cross(view.y, to_normal))
    to_y = plus(plus(times(to_yy, view.y), times(to_xy, view.x)), cross(to_normal, view.x))
    return to_x, to_y


@inlined
def axes_gradient(g, view, lens, to_x, to_y, to_z):
    """Given that to the rows along the scaled axes, the gradients to the axes, the scales and the two rows."""
    row_x, row_y = view.rows
    rows = row_x, row_y, lens.rotation[2]
    to_scales = products(to_x, along(rows[0], g.axes))
    to_scales = plus(to_scales, products(to_y, along(rows[1], g.axes)))
    to_scales = plus(to_scales, products(to_z, along(rows[2], g.axes)))
    to_x, to_y, to_z = products(to_x, g.scales), products(to_y, g.scales), products(to_z, g.scales)
    first = combination((to_x[0], to_y[0], to_z[0]), rows)
    second = combination((to_x[1], to_y[1], to_z[1]), rows)
    third = combination((to_x[2], to_y[2], to_z[2]), rows)
    return (first, second, third), to_scales, combination(to_x, g.axes), combination(to_y, g.axes)


@inlined
def quat_gradient(g, to_axes):
    """Given that to the axes, the gradient to the quaternion."""
    (a0, a1, a2), (b0, b1, b2), (c0, c1, c2) = to_axes
    w, x, y, z = g.quat
    to_w = TWO * (z * (a1 - b0) + y * (c0 - a2) + x * (b2 - c1))
    to_x = TWO * (y * (b0 + a1) + z * (c0 + a2) + w * (b2 - c1) - TWO * x * (b1 + c2))
    to_y = TWO * (x * (b0 + a1) + z * (c1 + b2) + w * (c0 - a2) - TWO * y * (a0 + c2))
    to_z = TWO * (x * (c0 + a2) + y * (c1 + b2) + w * (a1 - b0) - TWO * z * (a0 + b1))
    radial = to_w * w + to_x * x + to_y * y + to_z * z
    to_x, to_y, to_z = times(g.inverse, plus((to_x, to_y, to_z), times(-radial, (x, y, z))))
    return g.inverse * (to_w - radial * w), to_x, to_y, to_z


@inlined
def mean_gradient(view, lens, center, depth, to_row_x, to_row_y):
    """Given that to the mean in the image, its depth and the two rows, the gradient to the mean."""
    x, y, z = view.point
    turn, inverse = lens.rotation, ONE / z
    # A row is zoom (R_i - slope R_z); the slope is a constant where it was limited.
    slope_x, slope_y = view.slope
    zoom_x, zoom_y = view.zoom
    to_zoom_x = dot(to_row_x, plus(turn[0], times(-slope_x, turn[2])))
    to_zoom_y = dot(to_row_y, plus(turn[1], times(-slope_y, turn[2])))
    ratio_x, ratio_y = x / z, y / z
    to_ratio_x = center[0] * lens.focal[0] - where(ratio_x == slope_x, zoom_x * dot(to_row_x, turn[2]), ZERO)
    to_ratio_y = center[1] * lens.focal[1] - where(ratio_y == slope_y, zoom_y * dot(to_row_y, turn[2]), ZERO)
    to_depth = depth - inverse * (to_zoom_x * zoom_x + to_zoom_y * zoom_y + to_ratio_x * ratio_x + to_ratio_y * ratio_y)
    return combination((to_ratio_x * inverse, to_ratio_y * inverse, to_depth), turn)
