"""Other ways to read a map at a real-valued pixel position: what differs is the slope."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from gsjax.render.sampling import sample_bilinear

Read = Callable[[Array, Array], Array]
"""(map `[H, W]`, pixel position `[2]`) -> `[]` its value there, whose gradient to the position is the slope read."""


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
