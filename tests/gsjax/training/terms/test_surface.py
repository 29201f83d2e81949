"""The term of one view: against all pairs of splats in float64, closed forms, and where there is nothing to see."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, cloud, discs
from tolerances import assert_close

import rasterizer
from gsjax import rendering
from gsjax.gaussians import opacities, rotation_matrices, scales
from gsjax.normals.from_depth import depth_normals
from gsjax.numerics import masked_mean
from gsjax.rendering import View, depth
from gsjax.scene.batches import Batch
from gsjax.training.terms.losses import depth_normal

CAMERA = camera_at(size=(24, 20))
COUNT = 16
CLOUD = cloud(COUNT, sh_degree=0)
FIELDS = ("means", "quats", "log_scales", "logit_opacities")
ALL = jnp.ones((20, 24), bool)
SOME = ALL.at[:, 20:].set(False)
FACING = (0.0, 0.0, -1.0)


def render_view(gaussians):
    """All of the view but its colours, which the term does not read."""
    splats = rendering.splat(gaussians, CAMERA, 2048, depth_mode="plane")
    expected, alphas = depth.expected_depth(splats)
    axes = rendering.facing_axes(rendering.drawable(gaussians), CAMERA, splats.projection)
    return View(None, alphas, expected, splats, axes=rendering.features(splats, axes)[0])


def value(gaussians, valid):
    return depth_normal(gaussians, render_view(gaussians), Batch(CAMERA, None, valid, None, None))


value_and_gradient = jax.jit(jax.value_and_grad(value))


def dense(gaussians):
    """Weights and depths of all splats at every pixel, both `[20, 24, N]`, front to back, and their order."""
    camera = in_float64(CAMERA)
    shape = gaussians.quats, scales(gaussians), opacities(gaussians)
    p = rasterizer.project(gaussians.means, *shape, camera.viewmat[None], camera.K[None], 24, 20, depth_mode="plane")
    order = jnp.argsort(p.depths[0])
    y, x = jnp.meshgrid(jnp.arange(0.5, 20), jnp.arange(0.5, 24), indexing="ij")
    dx, dy = jnp.moveaxis(jnp.stack([x, y], -1)[:, :, None] - p.means2d[:, None, order], -1, 0)
    xx, xy, yy = p.conics[:, None, order].transpose(3, 0, 1, 2)
    alpha = opacities(gaussians)[None, None, order] * jnp.exp(-0.5 * (xx * dx * dx + yy * dy * dy) - xy * dx * dy)
    alpha = jnp.where((alpha >= 1 / 255) & p.visible[:, None, order], jnp.minimum(alpha, 0.99), 0)
    left = jnp.cumprod(1 - alpha, -1)
    weight = jnp.where(left > 1e-4, alpha * left / (1 - alpha), 0)
    slope_x, slope_y = p.slopes[:, None, order].transpose(3, 0, 1, 2)
    return weight, p.depths[:, None, order] + slope_x * dx + slope_y * dy, order


def dense_depth(weight, z):
    """Alphas, where they make a depth, and that depth (1 elsewhere)."""
    alphas = jnp.sum(weight, -1)
    covered = alphas > 0.5
    return alphas, covered, jnp.where(covered, jnp.sum(weight * z, -1), 1) / jnp.where(covered, alphas, 1)


def dense_depth_normal(gaussians, valid):
    """From the smallest axis of every splat, and the normals of the dense depth."""
    weight, z, order = dense(gaussians)
    alphas, covered, here = dense_depth(weight, z)
    of_depth = depth_normals(jnp.where(covered, here, 0), in_float64(CAMERA))
    smallest = jnp.argmin(gaussians.log_scales, -1)
    axes = jnp.take_along_axis(rotation_matrices(gaussians.quats), smallest[:, None, None], -1)[..., 0]
    facing = jnp.where(jnp.sum(axes * gaussians.means, -1, keepdims=True) > 0, -axes, axes)[order]
    apart = jnp.sum(weight * (1 - jnp.einsum("nk,hwk->hwn", facing, of_depth)), -1)
    fixed_alphas = jax.lax.stop_gradient(alphas)  # Of the sum of weights only the part with a normal has a gradient.
    return masked_mean(fixed_alphas * (apart - alphas + fixed_alphas), valid & jnp.any(of_depth != 0, -1))


dense_value_and_gradient = jax.jit(jax.value_and_grad(dense_depth_normal))


def in_float64(tree):
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), tree)


def layers(distance, gap, *, normal=FACING, opacity=0.7):
    """Two parallel planes of 8 discs, each of which covers the view; the discs of one do not lie on top of another."""
    normal = np.asarray(normal) / np.linalg.norm(normal)
    x, y = np.meshgrid([-0.24, -0.08, 0.08, 0.24], [-0.15, 0.15])
    rays = np.stack([x.ravel(), y.ravel(), np.ones(8)], -1)
    on_plane = [rays * (d * normal[2] / (rays @ normal))[:, None] for d in (distance, distance + gap)]
    return discs(np.concatenate(on_plane), normal, 0.15 * distance, opacity=opacity)


def larger(gaussians, factor):
    """The scene in a smaller unit, seen from the origin."""
    return replace(
        gaussians, means=gaussians.means * factor, log_scales=gaussians.log_scales + np.log(factor, dtype="f")
    )


SCENES = {
    "a cloud": CLOUD,
    "a cloud a thousand units away": larger(CLOUD, 250),
    "two layers": layers(4.0, 0.4),
    "two thin layers": layers(4.0, 0.02),
    "two slanted layers a thousand units away": layers(1000.0, 20.0, normal=(0.4, -0.3, -1.0)),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_term_is_that_of_all_splats_at_all_pixels(name):
    with jax.enable_x64(True):
        exact = dense_value_and_gradient(in_float64(SCENES[name]), SOME)
    expected_value, slopes = jax.tree.map(np.asarray, exact)
    value, gradient = value_and_gradient(SCENES[name], SOME)
    assert expected_value > 1e-6
    assert_close(value, expected_value, rtol=1e-4, atol=2e-8, why="a sum of weights in float32, less one")
    for field in FIELDS:
        actual, expected = getattr(gradient, field), getattr(slopes, field)
        assert_close(actual, expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max(), why="small numbers")


# --- nothing to be seen


def test_without_a_surface_there_is_neither_value_nor_gradient():
    beside = replace(CLOUD, means=CLOUD.means + jnp.array([[90.0, 0, 0]]))
    faint = replace(CLOUD, logit_opacities=jnp.full(COUNT, -9, jnp.float32))
    smoke = replace(layers(4.0, 0.4), logit_opacities=jnp.full(COUNT, -4, jnp.float32))  # drawn, but of no depth
    for scene, valid in ((beside, ALL), (faint, ALL), (smoke, ALL), (SCENES["two layers"], ~ALL)):
        value, gradient = value_and_gradient(scene, valid)
        assert float(value) == 0
        assert all(not np.any(leaf) for leaf in jax.tree.leaves(gradient))
