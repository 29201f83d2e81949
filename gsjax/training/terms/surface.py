"""The term on the surface that one view renders: it knows no photo and no normal map.

It reads the rendered depth, so only pixels that have one (`gsjax.rendering.MIN_COVERAGE`) take part.
"""

import jax
import jax.numpy as jnp
from jax import Array

from gsjax.gaussians import Gaussians
from gsjax.normals.from_depth import depth_normals
from gsjax.numerics import masked_mean
from gsjax.rendering import View
from gsjax.scene.batches import Batch


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
