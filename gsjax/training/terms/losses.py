"""The terms of the training loss: functions of (Gaussians, View, Batch).

Each is a mean, so that weights mean the same at every resolution.
"""

import jax
import jax.numpy as jnp
from jax import Array

from gsjax.gaussians import Gaussians, scales
from gsjax.measures.images import ssim
from gsjax.normals import density, sdf
from gsjax.numerics import masked_mean
from gsjax.render import MIN_COVERAGE, View
from gsjax.settings import NORMAL_TERMS
from gsjax.targets import Batch
from gsjax.training.sugar import sugar_density, sugar_sdf
from gsjax.training.terms.multi_view import multi_view, photometric
from gsjax.training.terms.surface import depth_normal, distortion


def l1(gaussians: Gaussians, view: View, batch: Batch) -> Array:
    """Mean absolute difference over valid pixels and channels."""
    del gaussians
    return masked_mean(jnp.mean(jnp.abs(view.colors - batch.image), axis=-1), batch.valid)


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
    is_surface = jnp.any(batch.normals != 0, axis=-1)  # pyright: ignore[reportArgumentType]
    return masked_mean(1 - view.alphas, batch.valid & is_surface)


def _normal(estimator: sdf.Estimator):
    def term(gaussians: Gaussians, view: View, batch: Batch) -> Array:
        covered = batch.valid & (jax.lax.stop_gradient(view.alphas) > MIN_COVERAGE)
        return sdf.misalignment(estimator(gaussians, view, batch.camera), batch.normals, covered)

    return term


sdf_normal = _normal(sdf.sdf_gradient_map)
pixel_normal = _normal(sdf.pixel_depth_map)
axis_normal = _normal(sdf.smallest_axis_map)
sdf_central = _normal(sdf.sdf_central_map)
sdf_bicubic = _normal(sdf.sdf_bicubic_map)
sdf_offset = _normal(sdf.sdf_offset_map)
density_center = _normal(density.density_center_map)
density_offset = _normal(density.density_offset_map)
density_sample = _normal(density.density_sample_map)

TERMS = {
    "l1": l1,
    "dssim": dssim,
    "entropy": entropy,
    "alpha": alpha,
    "thickness": thickness,
    "coverage": coverage,
    "distortion": distortion,
    "depth_normal": depth_normal,
    "multi_view": multi_view,
    "photometric": photometric,
    "sdf_normal": sdf_normal,
    "pixel_normal": pixel_normal,
    "axis_normal": axis_normal,
    "sdf_central": sdf_central,
    "sdf_bicubic": sdf_bicubic,
    "sdf_offset": sdf_offset,
    "density_center": density_center,
    "density_offset": density_offset,
    "density_sample": density_sample,
    "sugar_sdf": sugar_sdf,
    "sugar_density": sugar_density,
}
NEEDS_NORMALS = NORMAL_TERMS
NEEDS_DEPTH = frozenset(
    {"sdf_normal", "sdf_central", "sdf_bicubic", "sdf_offset", "pixel_normal"}
    | {"distortion", "depth_normal", "multi_view", "photometric", "sugar_sdf"}
)
NEEDS_GAUSSIANS = frozenset(
    {"entropy", "thickness", "axis_normal", "depth_normal"} | {"sdf_normal", "sdf_central", "sdf_bicubic", "sdf_offset"}
)
"""Beside the view, the Gaussians that show in it: where they lie and how they are shaped, not their colours."""
NEEDS_NEIGHBOR = frozenset({"multi_view", "photometric"})
NEEDS_SURROUNDINGS = frozenset({"density_center", "density_offset", "density_sample", "sugar_sdf", "sugar_density"})
SURFACE_TERMS = NEEDS_NORMALS | NEEDS_DEPTH | NEEDS_NEIGHBOR | NEEDS_SURROUNDINGS
"""Those that need more than the image of a view, and make a step dearer."""
