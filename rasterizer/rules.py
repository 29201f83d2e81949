"""The thresholds of alpha compositing, one frozen record with a preset per convention of the field."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Rules:
    """Where a splat stops to count. Hashable: a static argument of every compiled function.

    Attributes:
        alpha_max: Alpha is clamped here, so that 1 - alpha stays invertible in the backward pass.
        alpha_min: A splat is skipped at a pixel where its alpha is below this.
        transmittance_min: A splat that would bring a pixel's transmittance to or under this is not blended, and
            nothing behind it is.
        extent_sigmas: A splat's extent along each image axis, at most, in standard deviations.
        opacity_extent: Whether a faint splat's extent shrinks to where its alpha passes `alpha_min`.
        straight_through: Whether the gradient passes the alpha clamp as if it were not there.
        compensation_min: The least factor by which antialiasing dims a splat.
    """

    alpha_max: float = 0.99
    alpha_min: float = 1.0 / 255.0
    transmittance_min: float = 1e-4
    extent_sigmas: float = 3.33
    opacity_extent: bool = True
    straight_through: bool = False
    compensation_min: float = 0.005


GSPLAT = Rules()
"""gsplat 1.6 (its cuda/_constants.py): opacity-aware extents, no gradient through the clamp."""

INRIA = Rules(extent_sigmas=3.0, opacity_extent=False, straight_through=True)
"""The original 3DGS CUDA rasterizer: 3 sigma, gradient straight through the clamp."""

GSPLAT_1_5 = Rules(alpha_max=0.999, compensation_min=0.0)
"""gsplat up to 1.5.3."""

SMOOTH = Rules(
    alpha_max=1.0,
    alpha_min=0.0,
    transmittance_min=0.0,
    extent_sigmas=math.inf,
    opacity_extent=False,
    compensation_min=0.0,
)
"""No cuts: the image is a smooth function of splats in front of the cameras, while their order in depth is the same.

For checks by finite differences. Opacities must be under 1. Every splat is in the list of every tile.
"""
