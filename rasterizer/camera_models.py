"""Camera models: where a point is in the image, and what a small step in the world does there.

Each is two functions, which `project` takes; it knows no model by name. Jacobians are written by hand, so
that a derivative of a projection is plain arithmetic, on the axis of a fisheye too.
"""

from collections.abc import Callable
from functools import reduce
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from rasterizer.covariances import Matrix, Vector, dot

CameraModelName = Literal["pinhole", "ortho", "fisheye"]


class Lens(NamedTuple):
    """Intrinsics of the cameras, components `[C, 1]`."""

    K: Matrix  # pixels
    radial: Vector | None = None  # k1 k2 k3 k4 of a fisheye lens; None for an ideal one


class ImagePoint(NamedTuple):
    """A point and its surroundings in the image: components `[C, N]`, those of the rows at least `[C, 1]`."""

    mean2d: Vector  # x, y, pixels
    row_x: Vector  # of J W: pixels along x per scene unit in the world
    row_y: Vector


class CameraModel(NamedTuple):
    """A way to see. Hashable, static."""

    image_point: Callable[[Vector, Matrix, Lens, tuple[int, int]], ImagePoint]
    """(point in the camera's frame, viewmat, lens, image size in pixels) -> `ImagePoint`, differentiable."""
    ray: Callable[[Vector], Vector]
    """The direction, camera frame, any length, in which a point is seen."""


def _pinhole_point(point: Vector, viewmat: Matrix, lens: Lens, size: tuple[int, int]) -> ImagePoint:
    """A perspective image; z is positive."""
    x, y, z = point
    fx, fy, cx, cy = _focal_and_center(lens.K)
    width, height = size
    # The affine approximation explodes far outside the image: it is taken at most 30 % of half a field of view out.
    slope_x = jnp.clip(x / z, -cx / fx - 0.15 * width / fx, (width - cx) / fx + 0.15 * width / fx)
    slope_y = jnp.clip(y / z, -cy / fy - 0.15 * height / fy, (height - cy) / fy + 0.15 * height / fy)
    row_x = [fx / z * (viewmat[0][j] - slope_x * viewmat[2][j]) for j in range(3)]
    row_y = [fy / z * (viewmat[1][j] - slope_y * viewmat[2][j]) for j in range(3)]
    return ImagePoint([fx * x / z + cx, fy * y / z + cy], row_x, row_y)


def _ortho_point(point: Vector, viewmat: Matrix, lens: Lens, size: tuple[int, int]) -> ImagePoint:
    """A parallel projection along z: `fx`, `fy` are pixels per scene unit."""
    del size
    x, y, _ = point
    fx, fy, cx, cy = _focal_and_center(lens.K)
    rows = ([focal * viewmat[i][j] for j in range(3)] for i, focal in enumerate((fx, fy)))
    return ImagePoint([fx * x + cx, fy * y + cy], *rows)


def _fisheye_point(point: Vector, viewmat: Matrix, lens: Lens, size: tuple[int, int]) -> ImagePoint:
    """An equidistant image, of Kannala and Brandt: as far from the centre as the ray is from the axis.

    A ray at the angle theta comes out at theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) focal lengths
    from the centre, and nowhere (infinity) past the angle at which that stops to grow. A point on the axis behind the
    camera has no image either; all others have.

    With r the distance from the axis, d that from the eye, s = rho(theta) / r and q = rho'(theta) / d^2,

        J = f [[s + x^2 t, x y t, -x q], [x y t, s + y^2 t, -y q]],   t = (z q - s) / r^2,

    where s and t have limits on the axis, which `_angle_over_radius` holds.
    """
    del size
    # An image does not depend on a point's distance: a far one's square would overflow.
    largest = jax.lax.stop_gradient(reduce(jnp.maximum, [jnp.abs(part) for part in point]))
    largest = jnp.where(largest > 0, largest, 1)
    x, y, z = (part / largest for part in point)
    radius_squared = x * x + y * y
    over_radius, turn = _angle_over_radius(radius_squared, z)
    inverse_squared = 1 / (radius_squared + z * z)
    stretch = jnp.ones_like(z)
    if lens.radial is not None:
        k1, k2, k3, k4 = lens.radial
        square = over_radius * over_radius * radius_squared  # theta^2
        factor = 1 + square * (k1 + square * (k2 + square * (k3 + square * k4)))
        bend = 2 * k1 + square * (4 * k2 + square * (6 * k3 + square * 8 * k4))
        stretch = factor + square * bend  # rho'
        # z q - s, divided by r^2 term by term: nothing cancels near the axis.
        turn = factor * turn + z * inverse_squared * over_radius * over_radius * bend
        over_radius = factor * over_radius
        grows = (square < _fold(lens.radial) ** 2) & (stretch > 0)
        over_radius = jnp.where(grows, over_radius, jnp.inf)
    away = stretch * inverse_squared
    fx, fy, cx, cy = _focal_and_center(lens.K)
    steps_x = [over_radius + x * x * turn, x * y * turn, -x * away]
    steps_y = [x * y * turn, over_radius + y * y * turn, -y * away]
    axes = [[viewmat[i][j] for i in range(3)] for j in range(3)]
    rows = ([focal / largest * dot(step, axis) for axis in axes] for focal, step in ((fx, steps_x), (fy, steps_y)))
    return ImagePoint([fx * (x * over_radius) + cx, fy * (y * over_radius) + cy], *rows)


NEAR_AXIS = 0.02  # (r / z)^2 up to which a series is taken: its first term left out is 0.02^7 / 15 = 1e-13.


def _angle_over_radius(radius_squared: Array, z: Array) -> tuple[Array, Array]:
    """The quotients theta / r and (z / d^2 - theta / r) / r^2, for theta = atan2(r, z)."""
    in_front = jnp.maximum(z, 0)
    floor = NEAR_AXIS * in_front * in_front
    is_near = radius_squared < floor
    # Near the axis r has no derivative, and the second one is a difference of equals.
    safe = jnp.maximum(radius_squared, 0.5 * floor)
    radius = jnp.sqrt(jnp.where(safe > 0, safe, 1))
    over_radius = jnp.where(safe > 0, jnp.arctan2(radius, z) / radius, jnp.inf)
    turn = (z / (radius * radius + z * z) - over_radius) / (radius * radius)

    # atan(sqrt w) / sqrt w = 1 - w / 3 + w^2 / 5 - ..., and twice its derivative.
    near_z = jnp.where(is_near, z, 1)
    w = jnp.where(is_near, radius_squared, 0) / (near_z * near_z)
    terms = [(-1) ** n / (2 * n + 1) for n in range(8)]
    series = reduce(lambda total, term: total * w + term, reversed(terms[:-1]), jnp.zeros_like(w))
    slope = reduce(lambda total, n: total * w + 2 * n * terms[n], reversed(range(1, len(terms))), jnp.zeros_like(w))
    return jnp.where(is_near, series / near_z, over_radius), jnp.where(is_near, slope / near_z**3, turn)


ANGLES = np.radians(np.arange(1, 181))  # At which a lens is asked whether its image still grows.


def _fold(radial: Vector) -> Array:
    """`[C, 1]` the first of `ANGLES` at which the image's radius stops to grow, radians; infinity where none is."""
    k1, k2, k3, k4 = (jax.lax.stop_gradient(k)[..., None] for k in radial)
    each = jnp.expand_dims(jnp.asarray(ANGLES, k1.dtype), range(k1.ndim - 1))
    square = each * each
    growth = 1 + square * (3 * k1 + square * (5 * k2 + square * (7 * k3 + square * 9 * k4)))
    angles = jnp.where(growth > 0, jnp.inf, each)
    return jnp.min(angles, -1)


def _focal_and_center(K: Matrix) -> tuple[Array, Array, Array, Array]:
    return K[0][0], K[1][1], K[0][2], K[1][2]


def _towards(point: Vector) -> Vector:
    return point


def _along_z(point: Vector) -> Vector:
    return [jnp.zeros_like(point[0]), jnp.zeros_like(point[1]), jnp.ones_like(point[2])]


CAMERA_MODELS: dict[str, CameraModel] = {
    "pinhole": CameraModel(_pinhole_point, _towards),
    "ortho": CameraModel(_ortho_point, _along_z),
    "fisheye": CameraModel(_fisheye_point, _towards),
}
