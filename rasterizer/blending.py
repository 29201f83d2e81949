"""The alpha of one splat at one pixel and the front-to-back blend: the few lines that every backend shares."""

import jax.numpy as jnp
from jax import Array

from rasterizer.rules import Rules


def splat_sigma(dx: Array, dy: Array, conic_xx: Array, conic_xy: Array, conic_yy: Array) -> Array:
    """Half the squared Mahalanobis distance of the pixel offset (dx, dy)."""
    return 0.5 * (conic_xx * dx * dx + conic_yy * dy * dy) + conic_xy * dx * dy


def cut_alpha(unclamped: Array, sigma: Array, rules: Rules) -> Array:
    """Alpha as blended: clamped above, zero under the cut and where rounding made sigma negative."""
    kept = (unclamped >= rules.alpha_min) & (sigma >= 0)
    return jnp.where(kept, jnp.minimum(unclamped, rules.alpha_max), 0)
