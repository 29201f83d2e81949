"""Normal maps from rendered depth: as it is, and smoothed to train against.

Maps are `[H, W, 3]`, unit, in the camera frame (x right, y down, z forward), towards the camera, and zero where there
is no normal.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax.cameras import Camera, pixel_rays, unproject
from gsjax.numerics import safe_normalize

_LARGEST_MISFIT = 0.03  # of a plane, relative to the depth, for its normal to count
_SMALLEST_MISFIT = 1e-4  # better fits are no better: float32 ends there


def depth_normals(depth: Array, camera: Camera) -> Array:
    """Normals of a depth map, by central differences of the unprojected points.

    At the image border, and where the neighbour on one side has no depth, the difference is one-sided.

    Args:
        depth: `[H, W]` camera z, scene units; 0 where there is none.
        camera: The view.

    Returns:
        `[H, W, 3]`, differentiable in `depth`; zero where the pixel, or both neighbours along an axis, have no depth.
    """
    if depth.shape != (camera.height, camera.width):
        raise ValueError(f"{depth.shape=} does not match {camera.height=}, {camera.width=}")
    points, valid = unproject(depth, camera), depth > 0
    along_x, has_x = _difference(points, valid, axis=1)
    along_y, has_y = _difference(points, valid, axis=0)
    # Measured in pixels' footprints, so that neither the scene's scale nor the focal length decides what is zero.
    footprint = jnp.where(valid, depth, 1.0)[..., None] / camera.K[0, 0]
    normals = safe_normalize(jnp.cross(along_y / footprint, along_x / footprint))
    return jnp.where((valid & has_x & has_y)[..., None], normals, 0.0)


def _difference(points: Array, valid: Array, axis: int) -> tuple[Array, Array]:
    """Next minus previous point along an image axis, the pixel itself for a missing one; and whether any is there."""
    size = valid.shape[axis]
    width = [(1, 1) if a == axis else (0, 0) for a in range(2)]
    padded_points, padded_valid = jnp.pad(points, [*width, (0, 0)]), jnp.pad(valid, width)

    def neighbour(start: int) -> tuple[Array, Array]:
        there = jax.lax.slice_in_dim(padded_points, start, start + size, axis=axis)
        exists = jax.lax.slice_in_dim(padded_valid, start, start + size, axis=axis)
        return jnp.where(exists[..., None], there, points), exists

    (behind, has_behind), (ahead, has_ahead) = neighbour(0), neighbour(2)
    return ahead - behind, has_ahead | has_behind


@partial(jax.jit, static_argnames="sigma")
def smoothed_depth_normals(depth: Array, alphas: Array, camera: Camera, *, sigma: float = 2.0) -> Array:
    """Normals of a noisy depth map, smooth on surfaces and sharp at their edges: the prior of one who has no network.

    Inverse depth is linear in the pixel wherever the surface is a plane. So a plane is fitted to it in a Gaussian
    window about every pixel; and every pixel takes its plane from the windows around it, its own and 20 shifted ones,
    weighted by how well each fits (the idea of the Kuwahara filter): at an edge those that lie on one side of it.
    Colours play no part: the edges of a texture are not those of a shape.

    Args:
        depth: `[H, W]` rendered expected depth, camera z; 0 where there is none.
        alphas: `[H, W]` coverage, 0..1; pixels under one half do not count.
        camera: The view.
        sigma: Of the windows, pixels; they are shifted by up to 2.4 sigma. More suits larger images and more noise.

    Returns:
        `[H, W, 3]`; zero where there is no depth and where no window fits to 3 % of the depth (mixed pixels at the
        borders of objects).
    """
    if not depth.shape == alphas.shape == (camera.height, camera.width):
        raise ValueError(f"{depth.shape=}, {alphas.shape=} do not match {camera.height=}, {camera.width=}")
    valid = (depth > 0) & (alphas > 0.5)
    inverse_depth = jnp.where(valid, 1.0 / jnp.where(valid, depth, 1.0), 0.0)
    planes, variance = _fit_planes(inverse_depth, valid, sigma)
    plane, misfit = _choose_planes(planes, variance, inverse_depth, sigma)
    reliable = valid & (misfit < _LARGEST_MISFIT)
    return jnp.where(reliable[..., None], _plane_normals(plane, camera), 0.0)


def _fit_planes(values: Array, valid: Array, sigma: float) -> tuple[Array, Array]:
    """Least-squares planes in a Gaussian window about every pixel.

    Returns:
        `[H, W, 3]` value at the window's centre and slopes along x and y per pixel; and `[H, W]` the weighted mean of
        the squared residual, infinite where less than 15 % of the window is valid.
    """
    weights = valid.astype(values.dtype)
    mass, x, y = (_moment(weights, sigma, *powers) for powers in ((0, 0), (1, 0), (0, 1)))
    xx, xy, yy = (_moment(weights, sigma, *powers) for powers in ((2, 0), (1, 1), (0, 2)))
    right = jnp.stack([_moment(values, sigma, *powers) for powers in ((0, 0), (1, 0), (0, 1))], axis=-1)
    # Coordinates are in units of sigma, moments of order 1: the ridge only decides where a window is all but empty.
    rows = [[mass + 1e-6, x, y], [x, xx + 1e-3, xy], [y, xy, yy + 1e-3]]
    first, second, third = (jnp.stack(row, axis=-1) for row in rows)
    adjugate = jnp.stack([jnp.cross(second, third), jnp.cross(third, first), jnp.cross(first, second)], axis=-1)
    determinant = jnp.sum(first * adjugate[..., 0], axis=-1, keepdims=True)
    planes = jnp.sum(adjugate * right[..., None, :], axis=-1) / determinant
    residual = _moment(values * values, sigma, 0, 0) - jnp.sum(planes * right, axis=-1)
    variance = jnp.maximum(residual, 0.0) / jnp.maximum(mass, 1e-6)
    per_pixel = jnp.array([1.0, 1.0 / sigma, 1.0 / sigma], values.dtype)
    return planes * per_pixel[None, None], jnp.where(mass > 0.15, variance, jnp.inf)


def _moment(image: Array, sigma: float, power_x: int, power_y: int) -> Array:
    """`[H, W]` sum over a normalised Gaussian window of image x^px y^py, offsets from the centre in units of sigma."""
    reach = math.ceil(2.5 * sigma)
    offsets = np.arange(-reach, reach + 1) / sigma
    window = np.exp(-0.5 * offsets**2) / np.exp(-0.5 * offsets**2).sum()
    for axis, power in ((1, power_x), (0, power_y)):
        size = image.shape[axis]
        padded = jnp.pad(image, [(reach, reach) if a == axis else (0, 0) for a in range(2)])
        image = jnp.zeros_like(image)
        for start, weight in enumerate(window * offsets**power):
            image += float(weight) * jax.lax.slice_in_dim(padded, start, start + size, axis=axis)
    return image


def _choose_planes(planes: Array, variance: Array, values: Array, sigma: float) -> tuple[Array, Array]:
    """Mean of the planes of the windows around every pixel, weighted by the inverse of their squared misfit.

    Returns:
        `[H, W, 3]` value and slopes at the pixel; and `[H, W]` the best window's misfit relative to the value.
    """
    height, width = values.shape
    reach = math.ceil(2.4 * sigma)
    planes = jnp.pad(planes, [(reach, reach), (reach, reach), (0, 0)])
    variance = jnp.pad(variance, reach, constant_values=jnp.inf)
    scale = jnp.where(values > 0, values, 1.0)
    total, weights, best = jnp.zeros((height, width, 3), values.dtype), jnp.zeros_like(values), jnp.inf
    for shift_x, shift_y in _shifts(sigma):
        window = (slice(reach + shift_y, reach + shift_y + height), slice(reach + shift_x, reach + shift_x + width))
        slope_x, slope_y = planes[window][..., 1], planes[window][..., 2]
        here = planes[window][..., 0] - shift_x * slope_x - shift_y * slope_y
        misfit = (variance[window] + 0.5 * (values - here) ** 2) / scale**2 + _SMALLEST_MISFIT**2
        total += jnp.stack([here, slope_x, slope_y], axis=-1) / misfit[..., None]
        weights += 1.0 / misfit
        best = jnp.minimum(best, misfit)
    return total / jnp.maximum(weights, 1e-12)[..., None], jnp.sqrt(best)


def _shifts(sigma: float) -> list[tuple[int, int]]:
    """The centre, 8 pixels on a ring of 1.2 sigma, 12 on one of 2.4 sigma."""
    rings = [(1.2 * sigma, 2 * np.pi * np.arange(8) / 8), (2.4 * sigma, 2 * np.pi * np.arange(12) / 12)]
    return [(0, 0)] + [(round(r * np.cos(a)), round(r * np.sin(a))) for r, angles in rings for a in angles]


def _plane_normals(plane: Array, camera: Camera) -> Array:
    """Normals `[H, W, 3]` of planes given by inverse depth and its slopes per pixel `[H, W, 3]`.

    For points P of a plane n.P = h, inverse depth is n.(ray / h), hence n / h follows from its value and slopes.
    """
    rays = pixel_rays(camera)
    x, y = camera.K[0, 0] * plane[..., 1], camera.K[1, 1] * plane[..., 2]
    away = jnp.stack([x, y, plane[..., 0] - rays[..., 0] * x - rays[..., 1] * y], axis=-1)
    return safe_normalize(-away / jnp.maximum(jnp.abs(plane[..., :1]), 1e-12))
