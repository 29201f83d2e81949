"""Effects in the compiled step are learned together with the Gaussians."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, cloud, photographed

from gsjax.effects import background, exposure, poses
from gsjax.effects.camera_twists import apply_twist, gauge
from gsjax.rendering import backdrop, gallery
from gsjax.scene import batches
from gsjax.scene.cameras import center
from gsjax.settings import Rates, Weights
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.optimizers import make_optimizer
from gsjax.training.state import initial_state
from gsjax.training.step import BACKGROUNDS, make_train_step
from gsjax.training.terms import weigh_terms

CAMERAS = [
    camera_at(eye, (0.0, 0.0, 4.0), size=(32, 32)) for eye in ((0.0, 0.0, 0.0), (1.0, 0.0, 0.3), (0.0, -1.0, 0.0))
]
CENTERS = np.stack([center(camera) for camera in CAMERAS])
SKY = backdrop.constant_coefficients(np.array([0.4, 0.6, 0.8]), 2)
SKY[1] = [0.3, 0.2, -0.2]
SKY[3] = [-0.2, 0.1, 0.1]
KEY = jax.random.key(0)
OPTIMIZER = make_optimizer(Rates(means=2e-3), 1.0, 200)


@pytest.fixture(scope="module")
def data():
    return batches.with_photo_numbers(batches.read_batches(photographed(cloud(200, seed=5), CAMERAS)))


@pytest.fixture(scope="module")
def retaken(data):
    """Photos taken by factors, by cameras that stood elsewhere, under a sky; and the step that may learn all."""
    gains = np.array([[-0.2, 0.0, 0.1], [0.1, 0.1, 0.0], [0.1, -0.1, -0.1]], np.float32)
    # Half a degree, and as much of the distance.
    twists = np.float32(np.radians(0.5) * np.random.default_rng(3).normal(size=(3, 6)))
    targets = []
    pictures = gallery.pictures(cloud(200, seed=5), CAMERAS, SKY)
    for target, picture, gain, camera, twist in zip(data.views, pictures, gains, CAMERAS, twists, strict=True):
        image = np.rint(np.clip(255 * picture.colors * np.exp(gain), 0, 255)).astype(np.uint8)
        wrong = apply_twist(camera, jnp.asarray(-twist), 4.0)
        targets.append(replace(target, image=image, camera=replace(target.camera, viewmat=wrong.viewmat)))
    effects = {
        "exposure": exposure.make_effect(np.zeros((3, 3)), lambda step: jnp.float32(0.01)),
        "poses": poses.make_effect(CENTERS, 4.0, np.zeros(3), 1, lambda step: jnp.float32(1e-3) * 0.98**step),
        "background": background.make_effect(
            backdrop.constant_coefficients(np.full(3, 0.5), 2), lambda step: jnp.float32(0.02)
        ),
    }
    how = {"capacity": 8192, "background": BACKGROUNDS["black"], "sh_every": 2, "rule": DENSIFICATION_RULES["adc"]}
    step = make_train_step(OPTIMIZER, weigh_terms(Weights(dssim=0.0, alpha=0.0)), **how, effects=effects)
    return targets, effects, step, gains


def start(effects):
    return initial_state(cloud(200, seed=5), OPTIMIZER, DENSIFICATION_RULES["adc"], effects)


@pytest.fixture(scope="module")
def learned(retaken):
    """The numbers of all after 120 steps from the true scene."""
    targets, effects, step, _ = retaken
    state = start(effects)
    for index in range(120):
        state, _ = step(state, targets[index % 3], KEY)
    return state.effects.numbers


def test_gains_are_learned_from_photos(learned, retaken):
    true = retaken[3]
    gains = np.asarray(exposure.log_gains(learned["exposure"]))
    np.testing.assert_allclose(gains.mean(0), 0, atol=1e-6)
    assert np.abs(gains - true).max() < 0.05


def corners(cameras) -> np.ndarray:
    """Pixels of the corners of a box within the cloud, in every picture, one after the other."""
    box = np.stack(np.meshgrid([-1, 1], [-1, 1], [3.5, 4.5]), -1).reshape(-1, 3)
    local = [box @ np.asarray(c.viewmat)[:3, :3].T + np.asarray(c.viewmat)[:3, 3] for c in cameras]
    projections = [each @ np.asarray(c.K).T for each, c in zip(local, cameras, strict=True)]
    return np.concatenate([each[:, :2] / each[:, 2:] for each in projections]).ravel()


def test_cameras_go_where_their_photos_were_taken(learned, retaken):
    """Up to what moves all of them with the world: what the best such move leaves of the pixels that things are off."""
    targets, effects, *_ = retaken
    start_cameras = [
        replace(camera, viewmat=target.camera.viewmat) for camera, target in zip(CAMERAS, targets, strict=True)
    ]
    camera_of = jax.jit(effects["poses"].camera)
    refined_cameras = [
        replace(camera_of(learned["poses"], camera, jnp.int32(photo)), K=camera.K)
        for photo, camera in enumerate(start_cameras)
    ]
    with_world = [
        corners([apply_twist(c, jnp.asarray(1e-3 * t), 4.0) for c, t in zip(CAMERAS, mode.reshape(3, 6), strict=True)])
        for mode in gauge(CENTERS, 4.0).T
    ]
    slopes = (np.stack(with_world, -1) - corners(CAMERAS)[:, None]) / 1e-3

    def off(cameras):
        difference = corners(cameras) - corners(CAMERAS)
        return np.abs(difference - slopes @ np.linalg.lstsq(slopes, difference, rcond=None)[0]).mean()

    assert off(start_cameras) > 0.1  # pixels
    assert off(refined_cameras) < 0.1 * off(start_cameras)
    assert np.abs(learned["poses"]["log_focals"]).max() < 0.01


def test_the_sky_is_learned_where_it_is_open(learned, retaken):
    """Gains that are a little off make up for a sky that is: as the mean photo has it."""
    color_behind = jax.jit(backdrop.color_behind)
    pictures = gallery.pictures(cloud(200, seed=5), CAMERAS, np.zeros(3))
    for camera, picture in zip(CAMERAS, pictures, strict=True):
        sky, learned_sky = (np.asarray(color_behind(each, camera)) for each in (SKY, learned["background"]))
        assert np.abs((1 - picture.alphas)[..., None] * (learned_sky - sky)).mean() < 0.02


def test_a_step_that_is_not_taken_leaves_the_effects_as_they_were(retaken):
    targets, effects, step, _ = retaken
    state = start(effects)
    faulty = replace(state.gaussians, sh_dc=state.gaussians.sh_dc.at[:].set(jnp.nan))
    before = jax.tree.map(np.asarray, state.effects)
    state, reported = step(replace(state, gaussians=faulty), targets[0], KEY)
    assert not reported.finite
    jax.tree.map(np.testing.assert_array_equal, state.effects, before)
