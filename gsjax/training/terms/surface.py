"""Terms on what the rays of one view meet: they know no photo and no normal map.

All read the rendered depth, so only pixels that have one (`gsjax.rendering.MIN_COVERAGE`) take part.
"""

import jax
import jax.numpy as jnp
from jax import Array

from gsjax.gaussians import Gaussians
from gsjax.normals.from_depth import depth_normals
from gsjax.numerics import masked_mean, safe_divide
from gsjax.rendering import View, depth
from gsjax.targets import Batch


def distortion(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """How far apart the splats of a ray lie: mean over pixels of sum_{i<j} w_i w_j (z_i - z_j)^2 / D^2.

    The squared form of Mip-NeRF 360's distortion, as 2DGS computes it: from moments, A M2 - M1^2, without an order.
    2DGS measures in normalised device coordinates (near 0.2, far 100), whose steps are near dz / z^2 and so depend on
    the scene's unit. Here a step is dz / D, D the pixel's rendered depth: the same at any unit and any distance.

    Moments are about the view's mean depth, so that a far scene does not cancel. What rounding is left is about 1e-7
    of ((z - mean) / D)^2: noise of the value where layers are a thousandth of the depth apart; the gradient to the
    depths is a difference of first order and keeps its digits.

    Differentiable to depths and weights; not through D, or moving away would lower it.
    """
    del gaussians
    assert view.depth is not None, "the term reads the rendered depth"
    here = jax.lax.stop_gradient(view.depth)
    covered = batch.valid & (here > 0)
    first, second = depth.depth_moments(view.splats, masked_mean(here, here > 0))
    spread = view.alphas * second - first * first
    return masked_mean(safe_divide(spread, here * here, covered), covered)


def depth_normal(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """Normals of the splats against those of the depth that they render: mean of A sum_i w_i (1 - n_i . n_D) (2DGS).

    n_i is a Gaussian's smallest axis, facing the camera (2DGS: the disc's normal), n_D the normal of the depth map.
    A = sum_i w_i stands for the pixel's trust and carries no gradient, as in the authors' code: or a pixel whose
    normals disagree would become transparent. Over the pixels whose depth has a normal.

    Differentiable to rotations, and through the depth to means, scales and opacities.
    """
    del gaussians
    assert view.depth is not None and view.axes is not None, "the term reads rendered depth and axes"
    of_depth = depth_normals(view.depth, batch.camera)
    weight = jax.lax.stop_gradient(view.alphas)
    apart = weight * (weight - jnp.sum(view.axes * of_depth, axis=-1))
    return masked_mean(apart, batch.valid & jnp.any(of_depth != 0, axis=-1))
