"""Normal maps from rendered depth: as it is, and smoothed to train against.

Maps are `[H, W, 3]`, unit, in the camera frame (x right, y down, z forward), towards the camera, and zero where there
is no normal.
"""

import math
from collections.abc import Iterable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax.numerics import safe_normalize
from gsjax.scene.cameras import Camera, pixel_rays, unproject

_LARGEST_MISFIT = 0.03  # of a plane, relative to the depth, for its normal to count
_SMALLEST_MISFIT = 1e-4  # better fits are no better: float32 ends there
_SIGMA = 2.0  # of the windows, in pixels or blocks of them
_REDUCTIONS = (1, 2, 4, 8, 16)
_FEWEST_BLOCKS = 32  # across a view
_LEAST_COVERED = 0.97  # of what the smallest windows fit, for larger ones to be taken
_NOISE_DEGREES = 6.0  # by which halving the windows turns the median normal, for the larger to be kept


@jax.jit
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


@partial(jax.jit, static_argnames="reduction")
def smoothed_depth_normals(depth: Array, alphas: Array, camera: Camera, *, reduction: int = 1) -> Array:
    """Normals of a noisy depth map, smooth on surfaces and sharp at their edges: supervision without a network.

    Inverse depth is linear in the pixel wherever the surface is a plane. So a plane is fitted to it in a Gaussian
    window about every pixel; and every pixel takes its plane from the windows around it, its own and 20 shifted ones,
    weighted by how well each fits (the idea of the Kuwahara filter): at an edge those that are on one side of it.
    Colours play no part: the edges of a texture are not those of a shape.

    With a `reduction` all this is done on means over blocks, so that the windows grow and the cost does not; every
    pixel then takes its plane from the 9 blocks around it, weighted again by how well each fits that pixel.

    Args:
        depth: `[H, W]` rendered expected depth, camera z; 0 where there is none.
        alphas: `[H, W]` coverage, 0..1; pixels under one half have weight 0.
        camera: The view.
        reduction: Side of the blocks, pixels. Windows have a standard deviation of 2 blocks and are shifted by up to
            4.8. `chosen_reduction` finds the one that a scene needs.

    Returns:
        `[H, W, 3]`; zero where there is no depth and where no window fits to 3 % of the depth (mixed pixels at the
        borders of objects).
    """
    if not depth.shape == alphas.shape == (camera.height, camera.width):
        raise ValueError(f"{depth.shape=}, {alphas.shape=} do not match {camera.height=}, {camera.width=}")
    valid = (depth > 0) & (alphas > 0.5)
    inverse_depth = jnp.where(valid, 1.0 / jnp.where(valid, depth, 1.0), 0.0)
    values, weights = _reduced(inverse_depth, valid, reduction)
    plane, misfit = _choose_planes(*_fit_planes(values, weights), values)
    if reduction > 1:
        plane, misfit = _nearest_planes(plane, misfit, inverse_depth, reduction)
    reliable = valid & (misfit < _LARGEST_MISFIT)
    return jnp.where(reliable[..., None], _plane_normals(plane, camera), 0.0)


def chosen_reduction(views: Iterable[tuple[Array, Array, Camera]]) -> int:
    """The `reduction` that the noise of a scene requires and its shapes allow, by what larger windows would change.

    Bumps turn the normals of every window that is not much larger than they are, whatever the size of the image;
    shapes do not fit to planes any more once windows are as large as they. So: the largest windows that still fit
    nearly all that the smallest fit; and half of that, and again, as long as halving turns the median normal by
    little. Where there is no noise that leads to 1.

    Args:
        views: Depth and alphas `[H, W]` as `smoothed_depth_normals` reads them, and the camera, of some views.

    Returns:
        1, 2, 4, 8 or 16; at least 32 blocks are across the smallest view.
    """
    covered, turned = zip(*(_coverage_and_turns(*view) for view in views), strict=True)
    levels = min(map(len, covered))
    covered, turned = (np.mean([one[:levels] for one in each], axis=0) for each in (covered, turned))
    level = 0
    while level + 1 < levels and covered[level + 1] > _LEAST_COVERED * covered[0]:
        level += 1
    while level > 0 and turned[level] < _NOISE_DEGREES:
        level -= 1
    return _REDUCTIONS[level]


def _coverage_and_turns(depth: Array, alphas: Array, camera: Camera) -> tuple[list[float], list[float]]:
    """By reduction: the share of pixels with a normal, and by how many degrees its half turns the median one."""
    largest = max(1, min(depth.shape) // _FEWEST_BLOCKS)
    finer, shares, turns = None, [], []
    for reduction in (r for r in _REDUCTIONS if r <= largest):
        normals = np.asarray(smoothed_depth_normals(depth, alphas, camera, reduction=reduction))
        shares.append(float(np.any(normals, axis=-1).mean()))
        turns.append(0.0 if finer is None else _median_degrees(finer, normals))
        finer = normals
    return shares, turns


def _median_degrees(a: np.ndarray, b: np.ndarray) -> float:
    both = np.any(a, axis=-1) & np.any(b, axis=-1)
    if not both.any():
        return 0.0
    return float(np.degrees(np.arccos(np.clip(np.median(np.sum(a[both] * b[both], axis=-1)), -1, 1))))


def _reduced(values: Array, valid: Array, size: int) -> tuple[Array, Array]:
    """Means over the valid pixels of square blocks, 0 where there are none, and the share of valid pixels."""
    inside = _blocks(valid.astype(values.dtype), size)
    count = jnp.sum(inside, axis=(1, 3))
    return jnp.sum(_blocks(values, size), axis=(1, 3)) / jnp.maximum(count, 1.0), count / size**2


def _blocks(image: Array, size: int) -> Array:
    """`[H, W]` as `[rows of blocks, size, columns of blocks, size]`, padded with zeros at the right and the bottom."""
    height, width = image.shape
    image = jnp.pad(image, ((0, -height % size), (0, -width % size)))
    return image.reshape(image.shape[0] // size, size, image.shape[1] // size, size)


def _fit_planes(values: Array, weights: Array) -> tuple[Array, Array]:
    """Least-squares planes in a Gaussian window about every pixel.

    Returns:
        `[H, W, 3]` value at the window's centre and slopes along x and y per pixel; and `[H, W]` the weighted mean of
        the squared residual, infinite where less than 15 % of the window is valid.
    """
    weighted = weights * values
    along_x = _moments(jnp.stack([weights] * 3 + [weighted] * 2 + [weighted * values]), (0, 1, 2, 0, 1, 0), axis=2)
    moments = along_x[jnp.array([0, 1, 0, 2, 1, 0, 3, 4, 3, 5])]
    mass, x, y, xx, xy, yy, v, vx, vy, vv = _moments(moments, (0, 0, 1, 0, 1, 2, 0, 0, 1, 0), axis=1)
    # Coordinates are in units of sigma, moments of order 1: the ridge only decides where a window is all but empty.
    rows = [[mass + 1e-6, x, y], [x, xx + 1e-3, xy], [y, xy, yy + 1e-3]]
    first, second, third = (jnp.stack(row, axis=-1) for row in rows)
    adjugate = jnp.stack([jnp.cross(second, third), jnp.cross(third, first), jnp.cross(first, second)], axis=-1)
    determinant = jnp.sum(first * adjugate[..., 0], axis=-1, keepdims=True)
    right = jnp.stack([v, vx, vy], axis=-1)
    planes = jnp.sum(adjugate * right[..., None, :], axis=-1) / determinant
    variance = jnp.maximum(vv - jnp.sum(planes * right, axis=-1), 0.0) / jnp.maximum(mass, 1e-6)
    per_pixel = jnp.array([1.0, 1.0 / _SIGMA, 1.0 / _SIGMA], values.dtype)
    return planes * per_pixel[None, None], jnp.where(mass > 0.15, variance, jnp.inf)


def _moments(images: Array, powers: tuple[int, ...], axis: int) -> Array:
    """`[C, H, W]` sums of images over a normalised Gaussian window along an axis, times a power of the offset each.

    Offsets are from the window's centre, in units of sigma.
    """
    reach = math.ceil(2.5 * _SIGMA)
    offsets = np.arange(-reach, reach + 1) / _SIGMA
    window = np.exp(-0.5 * offsets**2) / np.exp(-0.5 * offsets**2).sum()
    weights = jnp.asarray(window[:, None] * offsets[:, None] ** np.array(powers), images.dtype)
    padded = jnp.pad(images, [(reach, reach) if a == axis else (0, 0) for a in range(3)])

    def add(tap: Array, total: Array) -> Array:
        neighbours = jax.lax.dynamic_slice_in_dim(padded, tap, images.shape[axis], axis=axis)
        return total + weights[tap][:, None, None] * neighbours

    return jax.lax.fori_loop(0, len(offsets), add, jnp.zeros_like(images))


def _choose_planes(planes: Array, variance: Array, values: Array) -> tuple[Array, Array]:
    """Mean of the planes of the windows around every pixel, weighted by the inverse of their squared misfit.

    `[H, W, 3]` are value and slopes at the pixel, `[H, W]` the best window's misfit relative to the value.
    """
    reach = math.ceil(2.4 * _SIGMA)
    planes = jnp.pad(planes, [(reach, reach), (reach, reach), (0, 0)])
    variance = jnp.pad(variance, reach, constant_values=jnp.inf)
    scale = jnp.where(values > 0, values, 1.0)
    shifts = jnp.asarray(_shifts())

    def add(index: Array, sums: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        total, weights, best = sums
        x, y = shifts[index]
        plane = jax.lax.dynamic_slice(planes, (reach + y, reach + x, 0), (*values.shape, 3))
        misfit = jax.lax.dynamic_slice(variance, (reach + y, reach + x), values.shape)
        slope_x, slope_y = plane[..., 1], plane[..., 2]
        here = plane[..., 0] - x.astype(values.dtype) * slope_x - y.astype(values.dtype) * slope_y
        misfit = (misfit + 0.5 * (values - here) ** 2) / scale**2 + _SMALLEST_MISFIT**2
        total += jnp.stack([here, slope_x, slope_y], axis=-1) / misfit[..., None]
        return total, weights + 1.0 / misfit, jnp.minimum(best, misfit)

    nothing = jnp.zeros((*values.shape, 3), values.dtype), jnp.zeros_like(values), jnp.full_like(values, jnp.inf)
    total, weights, best = jax.lax.fori_loop(0, len(shifts), add, nothing)
    return total / jnp.maximum(weights, 1e-12)[..., None], jnp.sqrt(best)


def _shifts() -> np.ndarray:
    """`[21, 2]` the centre, 8 pixels on a ring of 1.2 sigma, 12 on one of 2.4 sigma."""
    rings = [(1.2 * _SIGMA, 2 * np.pi * np.arange(8) / 8), (2.4 * _SIGMA, 2 * np.pi * np.arange(12) / 12)]
    ring_points = [[round(r * np.cos(a)), round(r * np.sin(a))] for r, angles in rings for a in angles]
    return np.array([[0, 0], *ring_points], np.int32)


def _nearest_planes(planes: Array, misfits: Array, values: Array, size: int) -> tuple[Array, Array]:
    """Planes of blocks resampled to pixels: the mean of the 9 blocks about each, by distance and by misfit there.

    Planes `[rows, columns, 3]` have the value at the block's centre and slopes per block; those that are returned,
    `[H, W, 3]`, slopes per pixel. The other array `[H, W]` is the best block's misfit.
    """
    rows, columns = misfits.shape
    planes = jnp.pad(planes, ((1, 1), (1, 1), (0, 0)))
    misfits = jnp.pad(misfits, 1, constant_values=jnp.inf)
    pixels = _blocks(values, size)
    scale = jnp.where(pixels > 0, pixels, 1.0)
    # Of a block's pixels from its centre, in blocks.
    offsets = (jnp.arange(size, dtype=values.dtype) + 0.5) / size - 0.5
    total = [jnp.zeros_like(pixels)] * 3
    weights, best = jnp.zeros_like(pixels), jnp.full_like(pixels, jnp.inf)
    for row, column in np.ndindex(3, 3):
        window = slice(row, row + rows), slice(column, column + columns)
        value, slope_x, slope_y = (planes[window][:, None, :, None, i] for i in range(3))
        y, x = (offsets - row + 1.0)[None, :, None, None], (offsets - column + 1.0)[None, None, None, :]
        here = value + x * slope_x + y * slope_y
        misfit = misfits[window][:, None, :, None] ** 2 + 0.5 * ((pixels - here) / scale) ** 2
        weight = (1.5 - jnp.abs(x)) * (1.5 - jnp.abs(y)) / misfit
        total = [t + weight * new for t, new in zip(total, (here, slope_x / size, slope_y / size), strict=True)]
        weights, best = weights + weight, jnp.minimum(best, misfit)

    def image(blocks: Array) -> Array:
        return blocks.reshape(rows * size, columns * size)[: values.shape[0], : values.shape[1]]

    weights = jnp.maximum(weights, 1e-12)
    return jnp.stack([image(t / weights) for t in total], axis=-1), jnp.sqrt(image(best))


def _plane_normals(plane: Array, camera: Camera) -> Array:
    """Normals `[H, W, 3]` of planes given by inverse depth and its slopes per pixel `[H, W, 3]`.

    For points P of a plane n.P = h, inverse depth is n.(ray / h), hence n / h follows from its value and slopes.
    """
    rays = pixel_rays(camera)
    x, y = camera.K[0, 0] * plane[..., 1], camera.K[1, 1] * plane[..., 2]
    away = jnp.stack([x, y, plane[..., 0] - rays[..., 0] * x - rays[..., 1] * y], axis=-1)
    return safe_normalize(-away / jnp.maximum(jnp.abs(plane[..., :1]), 1e-12))
