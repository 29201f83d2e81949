"""The regulariser's other source: the gradient of the density field instead of that of the depth-based estimate.

SuGaR, whose losses the paper replaces, calls the distance to the density's level set the SDF; its gradient's direction
is that of the density. A Gaussian sums over its nearest (`terms.surroundings`), one chunk of
them at a time.
"""

import jax
import jax.numpy as jnp
from jax import Array

from gsjax import density_field
from gsjax.cameras import Camera
from gsjax.gaussians import Gaussians, scales
from gsjax.normals.sdf import composite_directions
from gsjax.render import View
from gsjax.training.terms import Kept
from terms import evaluation_points
from terms.evaluation_points import EvaluationPoints


def density_center_map(gaussians: Gaussians, view: View, camera: Camera, kept: Kept) -> Array:
    """`[H, W, 3]` at the means: on a plane of Gaussians it lies in the plane, and asks for the wrong thing."""
    return _density_gradient_map(gaussians, view, camera, kept, evaluation_points.centers)


def density_offset_map(gaussians: Gaussians, view: View, camera: Camera, kept: Kept) -> Array:
    """`[H, W, 3]` one smallest standard deviation before the means."""
    return _density_gradient_map(gaussians, view, camera, kept, evaluation_points.before)


def density_sample_map(gaussians: Gaussians, view: View, camera: Camera, kept: Kept) -> Array:
    """`[H, W, 3]` at points drawn about the means, as SuGaR draws them."""
    return _density_gradient_map(gaussians, view, camera, kept, evaluation_points.random_points)


def _density_gradient_map(gaussians: Gaussians, view: View, camera: Camera, kept: Kept, at: EvaluationPoints) -> Array:
    """`[H, W, 3]` minus the density's gradient, unit and facing the camera, composited; zero where there is none."""
    field = density_field.kernels(gaussians)
    # In units of the Gaussian's own thickness: the direction stays, and the length no longer knows the scene's unit.
    thickness = jax.lax.stop_gradient(scales(gaussians).min(-1))

    def outward(place: Array, ids: Array, unit: Array) -> Array:
        return -unit * density_field.density_gradient(place, density_field.kernels_around(field, ids))

    rows = at(gaussians, camera, kept), kept.table, thickness
    world = density_field.at_each(outward, *rows)
    visible = view.splats.projection.visible[0, :, None]
    return composite_directions(jnp.where(visible, world, 0), gaussians, view, camera)
