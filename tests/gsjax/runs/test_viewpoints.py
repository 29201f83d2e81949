"""Cameras for Gaussians that come without any: an object from outside, a room from within."""

import jax
import numpy as np
import pytest

from gsjax import cameras as cams
from gsjax import gaussians as gs
from gsjax.runs import viewpoints


def cloud(means):
    count = len(means)
    return gs.Gaussians(
        means=np.float32(means),
        quats=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        log_scales=np.full((count, 3), np.log(0.08), np.float32),
        logit_opacities=np.full(count, 4.0, np.float32),
        sh_dc=np.zeros((count, 1, 3), np.float32),
        sh_rest=np.zeros((count, 0, 3), np.float32),
    )


def sphere(count, radius):
    points = np.random.default_rng(0).normal(size=(count, 3))
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (70.0, -20.0, 5.0)])
def test_an_object_is_looked_at_from_all_around(place):
    chosen = viewpoints.cameras_around(cloud(sphere(600, 1.0) + place))
    eyes = np.array([np.asarray(cams.center(c)) for c in chosen]) - place
    assert np.linalg.norm(eyes, axis=1).min() > 1.5
    directions = eyes / np.linalg.norm(eyes, axis=1, keepdims=True)
    assert np.abs(directions.mean(axis=0)).max() < 0.1
    forward = np.array([np.asarray(c.viewmat)[2, :3] for c in chosen])
    np.testing.assert_allclose(np.sum(forward * directions, axis=1), -1, atol=0.02)


@pytest.mark.parametrize(("count", "hidden_at", "size", "within"), [(150, 9.0, 1.5, 9.0), (500, 5.4, 0.35, 4.0)])
def test_what_its_surroundings_hide_is_looked_at_from_within_them(count, hidden_at, size, within):
    walls = 1900 - count  # One shape, one compilation.
    room = cloud(np.concatenate([sphere(walls, 4.0), sphere(count, hidden_at)]))
    room.log_scales[walls:] = np.log(size)
    eyes = np.array([np.asarray(cams.center(c)) for c in viewpoints.cameras_around(room)])
    assert np.linalg.norm(eyes, axis=1).max() < within


def test_faint_and_broken_gaussians_do_not_move_the_cameras():
    thing = cloud(sphere(600, 1.0))
    stray = cloud(np.concatenate([sphere(1295, 50.0), np.full((5, 3), np.nan)]))
    stray.logit_opacities[:] = -4.0
    both = jax.tree.map(lambda *parts: np.concatenate(parts), thing, stray)
    alone, together = viewpoints.cameras_around(thing), viewpoints.cameras_around(both)
    for a, b in zip(alone, together, strict=True):
        np.testing.assert_allclose(np.asarray(a.viewmat), np.asarray(b.viewmat), atol=1e-5)


def test_a_circle_is_as_high_and_as_wide_as_the_cameras_of_the_run():
    middle = np.array([5.0, -2.0, 3.0])
    angles = np.radians([0.0, 90.0, 180.0, 270.0])
    heights = np.array([1.0, 1.5, 2.0, 1.5])
    eyes = middle + np.stack([4 * np.cos(angles), 4 * np.sin(angles), heights], axis=-1)
    up = np.array([0.0, 0, 1])
    K = np.float32([[50, 0, 32], [0, 50, 24], [0, 0, 1]])
    level = [cams.Camera(cams.look_at(eye, np.array([*middle[:2], eye[2]]), up), K, 64, 48) for eye in eyes]
    circle = viewpoints.camera_circle(cloud(sphere(600, 0.5) + middle), level)
    around = np.array([np.asarray(cams.center(camera)) for camera in circle]) - middle
    np.testing.assert_allclose(around[:, 2], 1.5, atol=0.05)
    np.testing.assert_allclose(np.hypot(around[:, 0], around[:, 1]), 4.0, atol=0.1)
