"""Other slopes of the paper's estimate than the bilinear one: of central differences, of cubics, and off the means."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from gsjax import cameras
from gsjax.cameras import Camera
from gsjax.gaussians import Gaussians
from gsjax.normals.sdf import composite_directions, in_front, reads_depth
from gsjax.render import View
from gsjax.render.sampling import sample_bilinear
from terms import evaluation_points
from terms.evaluation_points import EvaluationPoints
from terms.sampling import Read, sample_bicubic, sample_central, shrunk


def sdf_central_map(gaussians: Gaussians, view: View, camera: Camera) -> Array:
    """`[H, W, 3]` the estimate's gradient with central differences for slopes: of 4 x 4 pixels instead of 2 x 2."""
    return _gradient_map(gaussians, view, camera, read=sample_central, covers=shrunk)


def sdf_bicubic_map(gaussians: Gaussians, view: View, camera: Camera) -> Array:
    """`[H, W, 3]` the same with the slopes of cubics through 4 x 4 pixels."""
    return _gradient_map(gaussians, view, camera, read=sample_bicubic, covers=shrunk)


def sdf_offset_map(gaussians: Gaussians, view: View, camera: Camera) -> Array:
    """`[H, W, 3]` the same one smallest standard deviation before the means, on the smallest axis."""
    return _gradient_map(gaussians, view, camera, at=evaluation_points.before)


def _gradient_map(
    gaussians: Gaussians,
    view: View,
    camera: Camera,
    *,
    at: EvaluationPoints = evaluation_points.centers,
    read: Read = sample_bilinear,
    covers: Callable[[Array], Array] = lambda covered: covered,
) -> Array:
    """`[H, W, 3]` gradients of the estimate at a place of each Gaussian, composited.

    Args:
        gaussians: The scene.
        view: Its render, with depth.
        camera: Of the view.
        at: The points.
        read: How depth is read there.
        covers: `[H, W]` pixels with depth -> those about which all has depth that `read` blends.
    """
    assert view.depth is not None, "the estimate reads the rendered depth"
    covered = covers(view.depth > 0)
    points = at(gaussians, camera, None)
    reads = jax.vmap(reads_depth, in_axes=(0, None, None))(points, covered, camera)
    usable = (view.splats.projection.visible[0] & reads)[:, None]
    points = jnp.where(usable, points, jax.lax.stop_gradient(in_front(camera))[None])

    def estimate(point: Array, depth: Array) -> Array:
        in_camera = cameras.world_to_camera(point, camera)
        return read(depth, cameras.project(in_camera, camera)) - in_camera[2]

    world = jax.vmap(jax.grad(estimate), in_axes=(0, None))(points, view.depth)
    return composite_directions(jnp.where(usable, world, 0), gaussians, view, camera)
