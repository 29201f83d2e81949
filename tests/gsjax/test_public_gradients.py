"""The gradients of the public functions equal finite differences, in float64."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from small_scenes import camera_at, cloud, plane

import gsjax
from gsjax.normals.sdf import sdf_gradient_map
from gsjax.scene.batches import Batch

SIZE = (16, 12)
RNG = np.random.default_rng(0)
PICTURES = RNG.uniform(0.1, 0.9, (2, 12, 16, 3))
MASK = RNG.random((12, 16)) > 0.2


def doubles(tree):
    return jax.tree.map(lambda x: jnp.asarray(np.asarray(x), jnp.float64), tree)


def assert_gradients(function, *arguments):
    check_grads(jax.jit(function), arguments, 1, ["rev"], atol=1e-6, rtol=1e-6, eps=1e-6)


CAMERA = camera_at((0.1, 0.2, -0.3), (0.0, 0.0, 4.0), size=SIZE, focal=15.0)


def test_of_a_render_to_the_gaussians_and_the_camera(x64):
    def render(gaussians, viewmat, K):
        camera = replace(CAMERA, viewmat=viewmat, K=K)
        view = gsjax.render(gaussians, camera, depth_mode="front", with_depth=True, backend="reference")
        return view.colors, view.alphas, view.depth

    camera = doubles(CAMERA)
    assert_gradients(render, doubles(cloud(8)), camera.viewmat, camera.K)


def test_of_the_signed_distance_estimate_to_point_depth_and_camera(x64):
    depth = jnp.asarray(RNG.uniform(3, 4, (12, 16)))
    assert_gradients(gsjax.depth_sdf, jnp.array([0.2, -0.1, 2.0]), depth, doubles(CAMERA))


def test_of_the_regulariser_through_the_composited_sdf_gradient_to_the_gaussians(x64):
    everywhere, normals = jnp.ones((12, 16), bool), jnp.asarray(RNG.normal(size=(12, 16, 3)))
    camera = doubles(CAMERA)
    batch = Batch(camera, jnp.asarray(PICTURES[0]), everywhere, None, normals)

    def regulariser(gaussians):
        view = gsjax.render(gaussians, camera, with_depth=True, backend="reference")
        return gsjax.align_normals(sdf_gradient_map).loss(gaussians, view, batch)

    assert_gradients(regulariser, doubles(plane((0.3, 0.2, -1.0), per_side=6, spacing=0.7)))


@pytest.mark.parametrize("measure", [gsjax.psnr, gsjax.ssim])
def test_of_the_measures_of_images_to_both(x64, measure):
    assert_gradients(lambda image, target: measure(image, target, jnp.asarray(MASK)), *jnp.asarray(PICTURES))
