"""Flights: through every keyframe, around a circle, round and round without a jerk, rigid all along."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scenes import camera_at

from gsjax.scene.camera_path import Keyframes, covering_fov, fly, through
from gsjax.scene.cameras import look_at, viewmat_center


def circle(count):
    angles = 2 * np.pi * np.arange(count) / count
    eyes = np.stack([3 * np.cos(angles), 3 * np.sin(angles), np.ones(count)], -1)
    return np.stack([look_at(eye, np.zeros(3), np.array([0, 0, 1.0])).astype(np.float64) for eye in eyes])


def random_poses(count, seed=0):
    random = np.random.default_rng(seed)
    viewmats = np.tile(np.eye(4), (count, 1, 1))
    viewmats[:, :3, :3] = Rotation.random(count, random_state=seed).as_matrix()
    viewmats[:, :3, 3] = random.normal(size=(count, 3)) * 5
    return viewmats


def assert_rigid(viewmats):
    R = viewmats[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-9)
    np.testing.assert_array_equal(viewmats[:, 3], np.tile([0, 0, 0, 1.0], (len(R), 1)))


@pytest.mark.parametrize("closed", [False, True])
def test_a_flight_meets_its_keyframes_and_stays_rigid(closed):
    keyframes = Keyframes(random_poses(6), np.radians([40, 50, 60, 55, 45, 50.0]), closed)
    viewmats, fovs = fly(keyframes, 20_001)
    assert_rigid(viewmats)
    np.testing.assert_allclose(viewmats[0], keyframes.viewmats[0], atol=1e-9)
    for viewmat, fov in zip(keyframes.viewmats, keyframes.fovs, strict=True):
        apart = np.abs(viewmats - viewmat).max(axis=(1, 2)) + np.abs(fovs - fov)
        assert apart.min() < 0.01
    if not closed:
        np.testing.assert_allclose(viewmats[-1], keyframes.viewmats[-1], atol=1e-9)
    speeds = np.linalg.norm(np.diff(viewmats[:, :3], axis=0), axis=(1, 2))
    jerks = np.abs(np.diff(np.append(speeds, speeds[:1]) if closed else speeds))
    assert jerks.max() < 0.02 * speeds.max(), "no sudden change of the speed, where it closes either"


def test_an_orbit_is_a_circle_at_one_speed():
    viewmats, _ = fly(Keyframes(circle(36), np.full(36, 0.7), True), 100)
    expected = circle(100)
    np.testing.assert_allclose(viewmats, expected, atol=2e-4)
    centers = np.stack([viewmat_center(viewmat) for viewmat in viewmats])
    steps = np.linalg.norm(np.diff(centers, axis=0, append=centers[:1]), axis=1)
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-3)


def test_two_keyframes_are_a_straight_line_and_one_place_twice_is_no_fault():
    start, end = random_poses(2)
    viewmats, _ = fly(Keyframes(np.stack([start, end]), np.full(2, 0.7), False), 5)
    middle = (viewmat_center(start) + viewmat_center(end)) / 2
    np.testing.assert_allclose(viewmat_center(viewmats[2]), middle, atol=1e-9)
    halves = Rotation.from_matrix(viewmats[:, :3, :3])
    assert (halves[0].inv() * halves[2]).magnitude() == pytest.approx((halves[2].inv() * halves[4]).magnitude())
    for poses in ([start, start, end], [start, start], [start, end, end, start]):
        assert_rigid(fly(Keyframes(np.stack(poses), np.full(len(poses), 0.7), False), 50)[0])
    assert_rigid(fly(Keyframes(np.stack([start, start, start]), np.full(3, 0.7), True), 50)[0])


def test_photos_in_no_order_are_passed_from_near_to_near():
    xs = np.array([0, 7, 3, 9, 1, 8, 2, 4, 6, 5.0])
    cameras = [camera_at((x, 0.0, 0.0), (x, 0.0, 4.0)) for x in xs]
    keyframes = through(cameras, 24, 1.0)
    np.testing.assert_allclose([viewmat_center(v)[0] for v in keyframes.viewmats], np.arange(10), atol=1e-5)
    in_order = [camera_at((x, 0.0, 0.0), (x, 0.0, 4.0)) for x in np.sort(xs)]
    thinned = through(in_order, 4, 1.0)
    np.testing.assert_allclose([viewmat_center(v)[0] for v in thinned.viewmats], [0, 3, 6, 9], atol=1e-5)


@pytest.mark.parametrize("aspect", [0.5, 3.0])
def test_all_that_a_photo_shows_is_in_the_film(aspect):
    camera = camera_at(size=(32, 24), focal=30.0)
    down = np.tan(covering_fov(camera, aspect) / 2)
    right = down * aspect
    assert down >= 12 / 33 - 1e-6 and right >= 16 / 30 - 1e-6
    assert down == pytest.approx(12 / 33) or right == pytest.approx(16 / 30)
