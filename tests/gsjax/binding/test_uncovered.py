"""Which Gaussians stay free: a wall, of which the mesh has the left half only."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, discs, plane

from gsjax import rendering
from gsjax.binding.uncovered import OVER_BORDER, SAME_SURFACE, uncovered_gaussians
from gsjax.scene import Pixels, batches, cameras, frame_of

CAMERAS = [camera_at((x, 0.2, 0.0), (0.0, 0.0, 4.0), size=(40, 32), focal=30.0) for x in (-0.4, 0.5)]
WALL = plane((0, 0, -1), per_side=13, spacing=0.4)  # x and y in -2.4..2.4, at z = 4
OTHERS = {
    "hovers before the mesh": [-1.0, 0.1, 3.9],
    "lies behind the mesh": [-1.0, -0.6, 4.1],
    "hides behind the mesh": [-0.9, 0.6, 5.5],
    "stands before the mesh": [-0.8, 0.0, 2.5],
    "stands before the rest": [0.9, 0.3, 2.5],
    "is behind the cameras": [0.0, 0.0, -2.0],
}
BORDER = np.stack(np.broadcast_arrays(0.0, np.linspace(-3, 3, 601), 4.0), axis=-1)  # of the mesh


def wall_depth(camera) -> np.ndarray:
    """`[H, W]` camera z of the plane z = 4 in the world, seen through every pixel's centre."""
    rays = np.asarray(cameras.pixel_rays(camera), np.float64) @ np.asarray(cameras.rotation(camera), np.float64)
    return (4.0 - np.asarray(cameras.center(camera), np.float64)[2]) / rays[..., 2]


def mesh_depth(camera) -> np.ndarray:
    """The same where x < 0, and 0 elsewhere: what is seen of a mesh that ends there."""
    depth = wall_depth(camera)
    rays = np.asarray(cameras.pixel_rays(camera), np.float64) @ np.asarray(cameras.rotation(camera), np.float64)
    x = rays[..., 0] * depth + np.asarray(cameras.center(camera), np.float64)[0]
    return np.where(x < 0, depth, 0).astype(np.float32)


def masked_by(valid):
    """Both views, of which this much may be used."""
    pixels = Pixels(np.zeros((32, 40, 3), np.uint8), valid=valid)
    return batches.read_batches([frame_of("", np.asarray(c.viewmat), np.asarray(c.K), pixels) for c in CAMERAS])


@pytest.fixture(scope="module")
def scene():
    others = discs(np.array(list(OTHERS.values())), (0, 0, -1.0), 0.25, opacity=0.9)
    return jax.tree.map(lambda *both: jnp.concatenate(both), WALL, others)


@pytest.fixture(scope="module")
def data():
    return masked_by(np.full((32, 40), 255, np.uint8))


@pytest.fixture(scope="module")
def whole(scene, data):
    return uncovered_gaussians(scene, data, map(mesh_depth, CAMERAS), BORDER)


def test_the_choice_is_that_of_the_blending_weights(scene, data, whole):
    """Against the weights themselves: a channel a Gaussian, and numpy."""
    render_view = jax.jit(
        lambda camera: rendering.render(
            scene,
            camera,
            capacity=8192,
            background=jnp.zeros(3, jnp.float32),
            with_depth=True,
            extra=jnp.eye(scene.num_gaussians, dtype=jnp.float32),
        )
    )
    light, bare, elsewhere = np.zeros((3, scene.num_gaussians))
    for camera in CAMERAS:
        view = render_view(camera)
        weights, mesh = np.asarray(view.extra, np.float64), mesh_depth(camera)
        off = (mesh > 0) & (np.abs(np.asarray(view.depth) - mesh) > SAME_SURFACE * mesh)
        own = np.asarray(scene.means, np.float64) @ np.asarray(camera.viewmat)[2, :3] + np.asarray(camera.viewmat)[2, 3]
        light += weights.sum(axis=(0, 1))
        bare += weights[mesh == 0].sum(axis=0)
        for one in np.flatnonzero(weights[off].sum(axis=0)):
            around = np.average(mesh[off], weights=weights[off][:, one])
            if abs(own[one] - around) > SAME_SURFACE * around:
                elsewhere[one] += weights[off][:, one].sum()
    at_border = np.abs(np.asarray(scene.means)[:, 0]) <= 2 * np.exp(np.asarray(scene.log_scales).max(axis=1))
    at_border &= np.abs(np.asarray(scene.means)[:, 2] - 4) < 0.2
    stays = (bare + elsewhere > 0.5 * light) | at_border & (bare > OVER_BORDER * light)
    is_clear = np.abs(bare + elsewhere - 0.5 * light) > 1e-3 * light
    is_clear &= ~at_border | (np.abs(bare - OVER_BORDER * light) > 1e-3 * light)
    assert is_clear.sum() > 150
    np.testing.assert_array_equal(whole[is_clear], stays[is_clear])
    assert np.any(stays & (bare + elsewhere < 0.4 * light)), "some reach over the border"
    assert not np.any(whole[light == 0]) and np.any(light == 0)


def test_all_go_or_all_that_are_seen_stay(scene, data, whole):
    opaque = replace(scene, logit_opacities=scene.logit_opacities.at[-6:].set(-30.0))  # The wall alone.
    assert not np.any(uncovered_gaussians(opaque, data, map(wall_depth, CAMERAS), BORDER[:0]))
    without = uncovered_gaussians(scene, data, [np.zeros((32, 40), np.float32)] * 2, BORDER)
    assert np.all(without[whole]) and not without[-1] and without[: WALL.num_gaussians].mean() > 0.8


def test_masked_pixels_say_nothing(scene, data):
    left = np.broadcast_to(np.where(np.arange(40) < 24, 255, 0).astype(np.uint8), (32, 40))
    stays = uncovered_gaussians(scene, masked_by(left), map(mesh_depth, CAMERAS), BORDER)
    assert not np.any(stays[: WALL.num_gaussians][np.asarray(WALL.means)[:, 0] > 1.9]), "behind the masks in both"
    assert stays[WALL.num_gaussians + list(OTHERS).index("stands before the mesh")]
