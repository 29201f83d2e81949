"""Reading a map at a real-valued pixel position."""

import jax.numpy as jnp
from jax import Array


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


def reads_within(mask: Array, pixel: Array) -> Array:
    """`[]` bool: a pixel position (x, y) is between four pixel centres of the image, all of them in `mask` `[H, W]`.

    Where it does, `sample_bilinear` blends no value from outside the mask and has the slope of its patch.
    """
    height, width = mask.shape
    x, y = pixel - 0.5
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    column, row = (jnp.where(inside, at, 0).astype(jnp.int32) for at in (x, y))
    right, below = jnp.minimum(column + 1, width - 1), jnp.minimum(row + 1, height - 1)
    return inside & mask[row, column] & mask[row, right] & mask[below, column] & mask[below, right]
