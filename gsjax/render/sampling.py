"""Reading a map at a real-valued pixel position."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

Read = Callable[[Array, Array], Array]
"""(map `[H, W]`, pixel position `[2]`) -> `[]` its value there, whose gradient to the position is the slope read."""


def sample_bilinear(image: Array, pixel: Array) -> Array:
    """Value of a `[H, W]` map at one pixel position (x, y), pixel centres at +0.5.

    Beyond the outermost centres the border value is read, with zero slope. Differentiable to both arguments; the
    slope to `pixel` is that of the bilinear patch, constant along x at fixed y between two centres.
    """
    height, width = image.shape
    limit = jnp.array([width - 1, height - 1], pixel.dtype)
    position = jnp.clip(pixel - 0.5, 0, limit)
    corner = jnp.clip(jnp.floor(position), 0, jnp.maximum(limit - 1, 0))
    fraction = position - corner
    x, y = corner.astype(jnp.int32)
    right, below = jnp.minimum(x + 1, width - 1), jnp.minimum(y + 1, height - 1)
    top = image[y, x] * (1 - fraction[0]) + image[y, right] * fraction[0]
    bottom = image[below, x] * (1 - fraction[0]) + image[below, right] * fraction[0]
    return top * (1 - fraction[1]) + bottom * fraction[1]


@jax.custom_jvp
def sample_central(image: Array, pixel: Array) -> Array:
    """The value of `sample_bilinear`, with slopes of central differences: between one pixel before and one after.

    They are continuous in the position, and means over four cells; differentiable to both arguments again.
    """
    return sample_bilinear(image, pixel)


@sample_central.defjvp
def _(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    (image, pixel), (image_dot, pixel_dot) = primals, tangents
    right, down = jnp.eye(2, dtype=pixel.dtype)
    slopes = [sample_bilinear(image, pixel + step) - sample_bilinear(image, pixel - step) for step in (right, down)]
    change = sample_bilinear(image_dot, pixel) + 0.5 * jnp.sum(jnp.stack(slopes) * pixel_dot)
    return sample_bilinear(image, pixel), change


def sample_bicubic(image: Array, pixel: Array) -> Array:
    """Value of a `[H, W]` map at one pixel position, as `sample_bilinear`, through cubics (Catmull and Rom).

    At pixel centres it is the pixel and its slope the central difference; both are continuous. 4 x 4 pixels are read.
    """
    height, width = image.shape
    limit = jnp.array([width - 1, height - 1], pixel.dtype)
    position = jnp.clip(pixel - 0.5, 0, limit)
    corner = jnp.clip(jnp.floor(position), 0, jnp.maximum(limit - 1, 0))
    weights = [_catmull_rom(fraction) for fraction in position - corner]
    columns, rows = (
        jnp.clip(first + jnp.arange(-1, 3, dtype=jnp.int32), 0, size - 1)
        for first, size in zip(corner.astype(jnp.int32), (width, height), strict=True)
    )
    return jnp.sum(image[rows[:, None], columns[None]] * weights[0][None] * weights[1][:, None])


def _catmull_rom(t: Array) -> Array:
    """`[4]` weights of the samples at -1, 0, 1 and 2 for the place `t` `[]` between 0 and 1."""
    before = ((1 - 0.5 * t) * t - 0.5) * t
    here = (1.5 * t - 2.5) * t * t + 1
    there = ((2 - 1.5 * t) * t + 0.5) * t
    after = (0.5 * t - 0.5) * t * t
    return jnp.stack([before, here, there, after])


def shrunk(mask: Array) -> Array:
    """`[H, W]` bool: the pixels of a mask whose 3 x 3 pixels are all in it; none at the border of the image."""
    inside = jnp.pad(mask, 1)
    inside = inside[:-2] & inside[1:-1] & inside[2:]
    return inside[:, :-2] & inside[:, 1:-1] & inside[:, 2:]


def reads_within(mask: Array, pixel: Array) -> Array:
    """`[]` bool: a pixel position (x, y) lies between four pixel centres of the image, all of them in `mask` `[H, W]`.

    Where it does, `sample_bilinear` blends no value from outside the mask and has the slope of its patch.
    """
    height, width = mask.shape
    x, y = pixel - 0.5
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    column, row = (jnp.where(inside, at, 0).astype(jnp.int32) for at in (x, y))
    right, below = jnp.minimum(column + 1, width - 1), jnp.minimum(row + 1, height - 1)
    return inside & mask[row, column] & mask[row, right] & mask[below, column] & mask[below, right]
