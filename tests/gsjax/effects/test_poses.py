"""Cameras that move: twists in closed form, what no photo can tell, and poses found by what Gaussians show."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scenes import camera_at, cloud
from tolerances import assert_close

from gsjax.effects import poses
from gsjax.effects.alignment import align
from gsjax.effects.camera_twists import apply_twist, gauge
from gsjax.effects.poses import Move
from gsjax.rendering import gallery
from gsjax.scene import Pixels, frame_of
from gsjax.scene.cameras import Camera, center, project, world_to_camera

CAMERA = camera_at((0.4, -0.3, 0.2), (0.0, 0.1, 4.0), size=(32, 24))
POINTS = np.array([[0.3, -0.2, 4.0], [-0.8, 0.5, 3.0], [0.1, 0.9, 6.0]])
TURNS = {
    "none": np.zeros(3),
    "tiny": np.array([1e-12, -2e-12, 0.0]),
    "under the series": np.array([5e-4, 0.0, -5e-4]),
    "over the series": np.array([8e-4, 0.0, -8e-4]),
    "half a degree": np.radians([0.3, -0.2, 0.4]),
    "half a turn": np.pi * np.array([2, -1, 2]) / 3,
    "a whole turn": 2 * np.pi * np.array([0, 0.6, 0.8]),
}


def double(camera):
    return Camera(*(jnp.asarray(np.asarray(m), jnp.float64) for m in (camera.viewmat, camera.K)), 32, 24)


TWISTS = np.stack([np.append(turn, [0.01, -0.02, 0.03]) for turn in TURNS.values()])


def test_a_twist_turns_about_the_centre_and_shifts_it_along_the_axes_of_the_world(x64):
    camera = double(CAMERA)
    viewmats = jax.jit(jax.vmap(lambda twist: apply_twist(camera, twist, 4.0).viewmat))(jnp.asarray(TWISTS))
    for name, twist, viewmat in zip(TURNS, TWISTS, np.asarray(viewmats), strict=True):
        turn = Rotation.from_rotvec(twist[:3]).as_matrix()
        expected = np.asarray(camera.viewmat)[:3, :3] @ turn.T
        np.testing.assert_allclose(viewmat[:3, :3], expected, rtol=0, atol=1e-12, err_msg=name)
        # The given rotation is one to float32, and so is its centre.
        shift = -viewmat[:3, :3].T @ viewmat[:3, 3] - np.asarray(center(camera))
        np.testing.assert_allclose(shift, 4.0 * twist[3:], rtol=0, atol=1e-6, err_msg=name)
        np.testing.assert_array_equal(viewmat[3], [0, 0, 0, 1])


def total(numbers, camera):
    """Of six numbers of a twist and a focal length: where points are in the picture, and in the camera's frame."""
    camera = poses.zoom_camera(apply_twist(camera, numbers[:6], 4.0), numbers[6])
    local = jnp.stack([world_to_camera(jnp.asarray(point, numbers.dtype), camera) for point in POINTS])
    pixels = jnp.stack([project(point, camera) for point in local])
    weights = jnp.asarray(np.random.default_rng(0).normal(size=(3, 5)), numbers.dtype)
    return jnp.sum(jnp.concatenate([pixels, local], axis=1) * weights)


def test_gradients_are_finite_differences_at_every_turn(x64):
    """In float64; in float32 they are the same numbers, to its digits."""
    at = np.c_[TWISTS, np.ones(len(TWISTS))]
    step = 1e-5
    probes = at[:, None, None] + step * np.array([[1.0], [-1.0]])[:, :, None] * np.eye(7)
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(total), (0, None)))(
        jnp.asarray(np.r_[at, probes.reshape(-1, 7)]), double(CAMERA)
    )
    up, down = np.moveaxis(np.asarray(values[len(at) :]).reshape(len(at), 2, 7), 1, 0)
    differences = (up - down) / (2 * step)
    single = jax.jit(jax.vmap(jax.grad(total), (0, None)))(jnp.asarray(at, jnp.float32), CAMERA)
    for name, exact, rounded, difference in zip(TURNS, slopes, single, differences, strict=False):
        size = np.abs(difference).max()
        np.testing.assert_allclose(exact, difference, rtol=0, atol=1e-7 * size, err_msg=name)  # second order
        np.testing.assert_allclose(rounded, difference, rtol=0, atol=1e-4 * size, err_msg=name)  # pixels behind a 0.1


CENTERS = np.random.default_rng(1).normal(size=(5, 3)) + [10.0, 0, 0]


EFFECT = poses.make_effect(CENTERS, 2.0, np.array([0, 0, 1, 1, 1]), 2, lambda step: jnp.float32(0))
camera_of = jax.jit(EFFECT.camera)


def test_the_gauge_is_what_moves_all_cameras_with_the_world():
    """A small similarity of the world, against twists read off the cameras that it gives."""
    fixed = gauge(CENTERS, 2.0)
    assert fixed.shape == (30, 7)
    np.testing.assert_allclose(fixed.T @ fixed, np.eye(7), atol=1e-6)
    turn, shift, growth = np.array([1e-4, -2e-4, 3e-4]), np.array([2e-4, 0, -1e-4]), 1.0003
    after = growth * CENTERS @ Rotation.from_rotvec(turn).as_matrix().T + shift
    twists = np.c_[np.tile(turn, (5, 1)), (after - CENTERS) / 2.0].reshape(-1)
    left = twists - fixed @ (fixed.T @ twists)
    assert np.abs(left).max() < 1e-3 * np.abs(twists).max()
    apart = np.random.default_rng(2).normal(size=30)
    assert np.linalg.norm(apart - fixed @ (fixed.T @ apart)) > 0.5 * np.linalg.norm(apart)


@pytest.mark.parametrize(
    ("centers", "free"), [(CENTERS[:1], 0), (CENTERS[:2], 5), (CENTERS[:3], 11), (np.ones((4, 3)), 18)]
)
def test_few_photos_and_cameras_in_one_place_have_the_freedom_that_is_theirs(centers, free):
    """Of one photo the pose is where the world is; of two, a turn and the direction between them."""
    count, fixed = len(centers), gauge(centers, 2.0)
    assert 6 * count - fixed.shape[1] == free
    start = jnp.asarray(np.random.default_rng(0).normal(size=(count, 6)), jnp.float32)
    used, gradient_of = jax.vjp(lambda numbers: poses.twists({"twists": numbers}, fixed), start)
    assert np.isfinite(used).all() and np.isfinite(gradient_of(used)[0]).all()
    if not free:
        assert_close(used, np.zeros((1, 6), np.float32))


@pytest.mark.parametrize("size", [10.0, 1e30])
def test_focal_lengths_stay_within_their_bounds(size):
    numbers = EFFECT.initial | {"log_focals": jnp.asarray([size, -size], jnp.float32)}
    for photo, factor in ((0, np.exp(poses.LIMIT)), (4, np.exp(-poses.LIMIT))):
        K = camera_of(numbers, CAMERA, jnp.int32(photo)).K
        assert_close(K, CAMERA.K * np.float32([[factor, 1, 1], [1, factor, 1], [1, 1, 1]]))


def test_held_out_photos_keep_their_pose_and_share_their_cameras_focal_length():
    trained = np.array([True, False, True, True, True, True])
    centers, whose = np.insert(CENTERS, 1, [9.0, 9.0, 9.0], axis=0), np.array([0, 0, 0, 1, 1, 1])
    rng = np.random.default_rng(0)
    numbers = {"twists": jnp.asarray(0.01 * rng.normal(size=(5, 6)), jnp.float32), "log_focals": jnp.array([0.1, -0.1])}
    moves = poses.moves(numbers, centers, 2.0, trained, whose)
    assert moves[1] == Move((0, 0, 0), (0, 0, 0), pytest.approx(np.exp(0.1), rel=1e-6))
    photo = Pixels(np.zeros((24, 32, 3), np.uint8))
    frame = frame_of("0.png", np.asarray(CAMERA.viewmat), np.asarray(CAMERA.K), photo)
    same = camera_of(numbers, CAMERA, jnp.int32(2))  # The fourth photo is the third that is trained on.
    refined = moves[3].apply(frame)
    assert_close(refined.viewmat, np.asarray(same.viewmat))
    assert_close(refined.K, np.asarray(same.K))


@pytest.fixture(scope="module")
def draw():
    gaussians = cloud(200, seed=5)
    return lambda cameras: list(gallery.pictures(gaussians, cameras, np.zeros(3)))


def corners(camera):
    """Pixels of the corners of a box within the cloud."""
    box = np.stack(np.meshgrid([-1, 1], [-1, 1], [3.5, 4.5]), -1).reshape(-1, 3)
    local = box @ np.asarray(camera.viewmat, np.float64)[:3, :3].T + np.asarray(camera.viewmat)[:3, 3]
    return (local @ np.asarray(camera.K).T)[:, :2] / local[:, 2:]


def test_a_photo_is_aligned_with_gaussians_as_they_are(draw):
    (picture,) = draw([CAMERA])
    turn, shift = np.array([0.6, -0.8, 0.3]), np.array([-0.5, 0.2, 0.4])
    wrong = apply_twist(CAMERA, jnp.asarray(np.float32(np.radians(0.5) * np.append(turn, shift))), 4.0)
    estimate = align(wrong, picture.colors, np.ones((24, 32), bool), draw)
    right, before, after = (corners(camera) for camera in (CAMERA, wrong, estimate))
    assert np.abs(after - right).mean() < 0.05 * np.abs(before - right).mean()


def test_nothing_to_align_with_leaves_the_pose(draw):
    (picture,) = draw([CAMERA])
    assert align(CAMERA, picture.colors, np.zeros((24, 32), bool), draw) is CAMERA
    away = apply_twist(CAMERA, jnp.asarray([0.0, np.pi, 0, 0, 0, 0], jnp.float32), 1.0)
    assert align(away, picture.colors, np.ones((24, 32), bool), draw) is away
    # Nothing explains it, and no move may make it worse.
    inverted = 1 - picture.colors
    (aligned_picture,) = draw([align(CAMERA, inverted, np.ones((24, 32), bool), draw)])
    assert np.square(aligned_picture.colors - inverted).mean() <= np.square(picture.colors - inverted).mean()
