"""The text of `rasterizer.blending` a second time, of vectors of pixels: numba compiles it into the loops over a tile.

Names and order are those of the first. A splat's numbers are scalars, a pixel's are vectors, and nothing branches.
"""

from typing import NamedTuple

import numpy as np

from rasterizer._native.compiled import inlined
from rasterizer._native.vectors import absolute, floor, limit_bits, maximum, minimum, times_power_of_two, where

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
LOG2_E = np.float32(1.4426950408889634)
HARMLESS = np.float32(80)  # exp(-80) is nothing, and still a normal number.


class Thresholds(NamedTuple):
    """What the loops read of `rasterizer.Rules`, float32."""

    alpha_max: np.float32
    alpha_min: np.float32
    transmittance_min: np.float32
    differentiable_below: np.float32  # alpha before the clamp; infinite where the gradient passes it
    stop_after: np.float32  # of `rasterizer.Front`


@inlined
def exp_minus(sigma):
    """exp(-sigma) to 2e-7 of itself, 0 (nearly) where sigma is negative, over 80 or not a number."""
    # 2^t = 2^floor(t) 2^fraction: the first is added to the exponent's bits, the second is a polynomial that was fitted
    # to the least largest relative error on 0..1.
    t = limit_bits(sigma, HARMLESS) * -LOG2_E
    whole = floor(t)
    f = t - whole
    power = np.float32(1.8775767e-3)
    power = power * f + np.float32(8.9893397e-3)
    power = power * f + np.float32(5.5826318e-2)
    power = power * f + np.float32(2.4015361e-1)
    power = power * f + np.float32(6.9315308e-1)
    power = power * f + np.float32(0.99999994)
    return times_power_of_two(power, whole)


@inlined
def splat_sigma(dx, dy, conic_xx, conic_xy, conic_yy):
    """Half the squared Mahalanobis distance of the pixel offset (dx, dy)."""
    # What depends on dx alone is the same in every row of a strip: LLVM computes it once.
    return HALF * conic_xx * dx * dx + dy * (conic_xy * dx + HALF * conic_yy * dy)


@inlined
def cut_alpha(unclamped, rules):
    """Alpha as blended: clamped above, zero under the cut. `exp_minus` has seen to a negative sigma."""
    return where(unclamped >= rules.alpha_min, minimum(unclamped, rules.alpha_max), ZERO)


@inlined
def blend_splat(signed_t, alpha, rules):
    """The splat's weight, and the signed transmittance behind it, negative where the pixel has stopped."""
    left = signed_t * (ONE - alpha)
    live = left > rules.transmittance_min
    return where(live, signed_t - left, ZERO), where(live, left, -absolute(signed_t))


@inlined
def front_weight(t, weight, stop_after):
    """The part of a splat's weight that uses up light above `stop_after`, of transmittance `t` in front of it."""
    return minimum(weight, maximum(t - stop_after, ZERO))


@inlined
def unblend_splat(t, behind, lit, alpha, unclamped, rules):
    """dL/dsigma, the splat's weight, and `t` and `behind` in front of it, where no channel ends in front."""
    inverse = ONE / (ONE - alpha)
    t = t * inverse
    weight = t * alpha
    return slope(t, behind, lit, alpha, unclamped, inverse, rules), weight, t, behind + weight * lit


@inlined
def unblend_in_front(t, behind, lit, alpha, unclamped, rules, lit_in_front):
    """The same where some channels end in front; `lit_in_front` is dL/dimage . features of these."""
    inverse = ONE / (ONE - alpha)
    t = t * inverse
    weight = t * alpha
    counted = front_weight(t, weight, rules.stop_after)
    is_whole = counted == weight
    passed = weight * lit + where(is_whole | (counted <= ZERO), counted, t) * lit_in_front
    lit = lit + where(is_whole, lit_in_front, ZERO)
    return slope(t, behind, lit, alpha, unclamped, inverse, rules), weight, t, behind + passed


@inlined
def slope(t, behind, lit, alpha, unclamped, inverse, rules):
    """dL/dsigma: dL/dalpha = T lit - (what lies behind) / (1 - alpha), and d alpha / d sigma = -unclamped alpha."""
    differentiable = (alpha > ZERO) & (unclamped < rules.differentiable_below)
    return (behind * inverse - t * lit) * where(differentiable, unclamped, ZERO)
