"""The alpha of one splat at one pixel, the front-to-back blend and its way back, in jnp.

Elementwise on arrays of any shape, so that the same text runs in XLA's loops and inside a GPU kernel. The CPU's loops,
which numba compiles, have a second text of it in the same order: `rasterizer._native.blending`.
"""

import jax.numpy as jnp
from jax import Array

from rasterizer.rules import Rules


def splat_sigma(dx: Array, dy: Array, conic_xx: Array, conic_xy: Array, conic_yy: Array) -> Array:
    """Half the squared Mahalanobis distance of the pixel offset (dx, dy)."""
    # Half a conic is a scalar of the splat: seven operations a pixel are left.
    return dx * (0.5 * conic_xx * dx + conic_xy * dy) + 0.5 * conic_yy * dy * dy


def cut_alpha(unclamped: Array, sigma: Array, rules: Rules) -> Array:
    """Alpha as blended: clamped above, zero under the cut and where rounding made sigma negative."""
    is_drawn = (unclamped >= rules.alpha_min) & (sigma >= 0)
    return jnp.where(is_drawn, jnp.minimum(unclamped, rules.alpha_max), 0)


def blend_splat(signed_t: Array, alpha: Array, rules: Rules) -> tuple[Array, Array]:
    """The splat's weight, of its alpha as cut, and the signed transmittance behind it.

    Transmittance is negative where the pixel has stopped: no flag array is carried.
    """
    left = signed_t * (1 - alpha)
    live = left > rules.transmittance_min
    return jnp.where(live, signed_t - left, 0), jnp.where(live, left, -jnp.abs(signed_t))


def front_weight(t: Array, weight: Array, stop_after: float) -> Array:
    """The part of a splat's weight that uses up light above `stop_after`, of transmittance `t` in front of it."""
    return jnp.minimum(weight, jnp.maximum(t - stop_after, 0))


def unblend_splat(
    t: Array,
    behind: Array,
    lit: Array,
    alpha: Array,
    unclamped: Array,
    rules: Rules,
    front: tuple[Array, float] | None = None,
) -> tuple[Array, Array, Array, Array]:
    """One splat back to front: its part of the gradient, and the state in front of it.

    Args:
        t: Transmittance behind the splat.
        behind: Sum over what is behind of weight x lit, background and dL/dT included.
        lit: dL/dimage . features of the splat.
        alpha: As cut; zero where the splat is not blended.
        unclamped: Alpha before the clamp.
        rules: Whether the gradient passes the clamp.
        front: `lit` of the channels that end in front, and the transmittance at which they do.

    Returns:
        dL/dsigma, the splat's weight (dL/dfeatures per dL/dimage), and `t` and `behind` in front of it.
    """
    inverse = 1 / (1 - alpha)
    t = t * inverse
    weight = t * alpha
    passed = weight * lit
    if front is not None:
        lit_in_front, stop_after = front
        counted = front_weight(t, weight, stop_after)
        is_whole = counted == weight
        lit = lit + jnp.where(is_whole, lit_in_front, 0)
        # Of the splat that uses the light up t - stop_after counts, however opaque it is.
        passed = passed + jnp.where(is_whole | (counted <= 0), counted, t) * lit_in_front
    # dL/dalpha = T lit - (what is behind) / (1 - alpha); d alpha / d sigma = -unclamped alpha.
    differentiable = alpha > 0 if rules.straight_through else (alpha > 0) & (unclamped < rules.alpha_max)
    d_sigma = jnp.where(differentiable, (behind * inverse - t * lit) * unclamped, 0)
    return d_sigma, weight, t, behind + passed
