"""The terms of one view. Each is a mean, so that weights mean the same at every resolution."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from gsjax.gaussians import Gaussians, scales
from gsjax.metrics.images import ssim
from gsjax.normals import sdf
from gsjax.normals.from_depth import depth_normals
from gsjax.numerics import masked_mean, mean_channel
from gsjax.rendering import MIN_COVERAGE, View
from gsjax.scene.batches import Batch

Loss = Callable[[Gaussians, View, Batch], Array]
"""(Gaussians, View, Batch) -> `[]`."""


def l1(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """Mean absolute difference over valid pixels and channels."""
    del gaussians
    return masked_mean(mean_channel(jnp.abs(view.colors - batch.image)), batch.valid)


def dssim(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """1 - SSIM over valid pixels (3DGS; not halved)."""
    del gaussians
    return 1 - ssim(view.colors, batch.image, batch.valid)


def entropy(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """Mean binary entropy of the visible opacities, nats (SuGaR); closed form from the log-odds, exact at 0 and 1."""
    del batch
    logits = gaussians.logit_opacities
    value = jax.nn.softplus(logits) - logits * jax.nn.sigmoid(logits)
    return masked_mean(value, view.splats.projection.visible[0])


def alpha(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """Mean |alpha - matte| over valid pixels: no smoke around an object, no holes in it."""
    del gaussians
    return masked_mean(jnp.abs(view.alphas - batch.matte), batch.valid)  # pyright: ignore[reportOperatorIssue]


def sky(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """Mean over valid pixels of what covers those that show open sky: nothing there is a surface, however far away."""
    del gaussians
    assert batch.sky is not None, "the plan has the term only where photos show sky"
    return masked_mean(jnp.where(batch.sky, view.alphas, 0), batch.valid)


def thickness(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """Mean smallest standard deviation of the visible Gaussians, in pixels at their depth (PGSR's, without a unit).

    Differentiable to the scales alone: a Gaussian is to become a disc, not to move away.
    """
    projection = view.splats.projection
    focal = jnp.sqrt(batch.camera.K[0, 0] * batch.camera.K[1, 1])
    visible = projection.visible[0]
    per_unit = jax.lax.stop_gradient(focal / jnp.where(visible, projection.depths[0], 1))
    return masked_mean(scales(gaussians).min(-1) * per_unit, visible)


def coverage(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """Mean 1 - alpha over the valid pixels that have a normal: where a surface is, no light comes from behind it.

    Without it a place whose colour is that of the background is a hole as cheaply as a surface.
    """
    del gaussians
    is_surface = jnp.any(batch.normals != 0, axis=-1)
    return masked_mean(1 - view.alphas, batch.valid & is_surface)


def measured_depth(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """Mean |log(rendered depth / measured depth)|, weighed by the measurement's confidence.

    A share, not a length: it means the same in any unit and at any distance, as the errors of a depth camera grow with
    what it measures. Over valid pixels that have both depths. Differentiable to the rendered depth.
    """
    del gaussians
    assert view.depth is not None and batch.depth is not None and batch.trust is not None
    is_known = batch.valid & jnp.isfinite(batch.depth) & (batch.depth > 0) & (view.depth > 0)
    off = jnp.log(jnp.where(is_known, view.depth, 1)) - jnp.log(jnp.where(is_known, batch.depth, 1))
    return masked_mean(jnp.abs(off), jnp.where(is_known, batch.trust, 0))


def depth_normal(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """Normals of the splats against those of the depth that they render: mean of A sum_i w_i (1 - n_i . n_D) (2DGS).

    n_i is a Gaussian's smallest axis, facing the camera (2DGS: the disc's normal), n_D the normal of the depth map.
    A = sum_i w_i is the pixel's trust and carries no gradient, as in the authors' code: or a pixel whose
    normals disagree would become transparent. Over the pixels whose depth has a normal.

    Differentiable to rotations, and through the depth to means, scales and opacities.
    """
    del gaussians
    assert view.depth is not None and view.axes is not None, "the term reads rendered depth and axes"
    of_depth = depth_normals(view.depth, batch.camera)
    weight = jax.lax.stop_gradient(view.alphas)
    apart = weight * (weight - jnp.sum(view.axes * of_depth, axis=-1))
    return masked_mean(apart, batch.valid & jnp.any(of_depth != 0, axis=-1))


def alignment_term(estimator: sdf.Estimator, measure: Callable[..., Array] = sdf.misalignment) -> Loss:
    """The term that aligns what an estimator composites with the normals (the paper's R, with its own estimator).

    `measure` is of (directions, normals, valid pixels), as `gsjax.normals.sdf.misalignment` has them.
    """

    def term(gaussians: Gaussians, view: View, batch: Batch) -> Array:
        covered = batch.valid & (jax.lax.stop_gradient(view.alphas) > MIN_COVERAGE)
        return measure(estimator(gaussians, view, batch.camera), batch.normals, covered)

    return term


sdf_normal = alignment_term(sdf.sdf_gradient_map)
pixel_normal = alignment_term(sdf.pixel_depth_map, sdf.doubted_misalignment)
