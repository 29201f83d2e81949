"""The browser's camera and ours are one view, who gets which picture when, and what pictures show."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scenes import camera_at, cloud
from tolerances import assert_close

from gsjax.rendering import backdrop, gallery
from gsjax.scene.cameras import Camera
from gsjax.scene.colors import to_bytes
from gsjax.viewer.page_camera import FOVS, PageCamera, camera_of, page_camera
from gsjax.viewer.picture_queue import REST, PictureQueue, Request
from gsjax.viewer.pictures import COLOR, DEPTH, KINDS, NORMALS, bare_background, draw_picture

TURN = Rotation.from_rotvec([0.4, -1.1, 0.7])
PAGE = PageCamera(np.array([0.3, -2.0, 1.5]), TURN.as_quat(scalar_first=True), 1.1, 1710, 903)


def on_picture(camera, points):
    """`[N, 2]` where points are seen, in shares of the picture's sides."""
    projections = (points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]) @ camera.K.T
    return projections[:, :2] / projections[:, 2:] / [camera.width, camera.height]


def test_a_point_is_where_the_page_sees_it_whatever_the_size_of_the_picture():
    rng = np.random.default_rng(0)
    rays = rng.uniform([-0.8, -0.5, 1.0], [0.8, 0.5, 1.0], (20, 3)) * rng.uniform(0.5, 9.0, (20, 1))
    half = np.tan(0.5 * PAGE.fov)
    up_down = 0.5 + 0.5 * rays[:, 1] / rays[:, 2] / half
    left_right = 0.5 + 0.5 * rays[:, 0] / rays[:, 2] / (half * PAGE.width / PAGE.height)
    expected = np.stack([left_right, up_down], -1)
    for size in ((960, 512), (320, 160), (64, 96)):
        camera = camera_of(PAGE, size)
        assert (camera.width, camera.height) == size
        points = PAGE.position + rays @ TURN.as_matrix().T
        np.testing.assert_allclose(on_picture(camera, points), expected, atol=2e-6)


def test_there_and_back_is_the_same_camera():
    camera = camera_at((0.4, -0.3, 0.2), (0.1, 0.1, 4.0), size=(48, 32))
    K = np.array([[30.0, 0, 24], [0, 30, 16], [0, 0, 1]], np.float32)
    centred = Camera(np.asarray(camera.viewmat), K, 48, 32)
    back = camera_of(page_camera(centred), (48, 32))
    assert_close((back.viewmat, back.K), (centred.viewmat, K))


@pytest.mark.parametrize(("fov", "expected_fov"), [(-1.0, FOVS[0]), (np.pi, FOVS[1])])
def test_a_field_of_view_that_no_pinhole_has_is_the_nearest_one_and_what_is_no_camera_is_none(fov, expected_fov):
    for broken in ({"position": np.array([0.0, np.nan, 0.0])}, {"wxyz": np.zeros(4)}, {"fov": np.nan}):
        assert camera_of(PAGE._replace(**broken), (64, 48)) is None
    camera = camera_of(PAGE._replace(fov=fov), (64, 48))
    assert np.isfinite(camera.K).all() and (np.diag(camera.K) > 0).all()
    np.testing.assert_allclose(2 * np.arctan(24 / camera.K[1, 1]), expected_fov, rtol=1e-5)


def take_all(queue):
    """All that is due now."""
    requests = []
    while (request := queue.take(0)) is not None:
        requests.append(request)
    return requests


def test_a_camera_gets_a_coarse_picture_at_once_and_the_full_one_when_it_rests_and_coarse_ones_come_first():
    clock, (first, second) = SimpleNamespace(now=100.0), (PAGE._replace(fov=fov) for fov in (1.0, 1.2))
    queue = PictureQueue(lambda: clock.now)
    queue.move("me", first)
    assert take_all(queue) == [Request("me", first, False)]
    clock.now += 0.9 * REST
    assert take_all(queue) == []
    clock.now += 0.2 * REST
    assert take_all(queue) == [Request("me", first, True)]
    clock.now += 100
    assert take_all(queue) == []
    queue.redraw()
    clock.now += 0.01
    queue.move("you", second)
    assert take_all(queue) == [Request("me", first, False), Request("you", second, False), Request("me", first, True)]


SCENE, BACKGROUND = cloud(30), np.array([0.1, 0.9, 0.4], np.float32)
SIZE = 32, 32


def camera(target=(0.0, 0.0, 4.0)):
    """As a page sends it."""
    return camera_of(page_camera(camera_at((0.0, 0.0, 0.0), target, size=SIZE)), SIZE)


def test_every_kind_is_the_picture_that_its_name_says():
    (picture,) = gallery.pictures(SCENE, [camera()], BACKGROUND)
    images = {kind: draw_picture(kind, SCENE, camera(), BACKGROUND) for kind in KINDS}
    assert all(image.shape == (32, 32, 3) and image.dtype == np.uint8 for image in images.values())
    np.testing.assert_allclose(images[COLOR].astype(int), to_bytes(picture.colors).astype(int), atol=1)
    nothing = picture.depth == 0
    assert nothing.any() and not nothing.all()
    assert (images[DEPTH][nothing] == 0).all() and (images[DEPTH][~nothing] > 0).all()
    assert (images[NORMALS][nothing] == 255).all() and (images[NORMALS][~nothing] < 255).any()


def test_a_view_of_nothing_is_the_background_and_a_sky_depends_on_the_direction():
    away = camera((0.0, 0.0, -4.0))
    bare = np.broadcast_to(to_bytes(BACKGROUND), (32, 32, 3))
    np.testing.assert_array_equal(draw_picture(COLOR, SCENE, away, BACKGROUND), bare)
    np.testing.assert_array_equal(bare_background(BACKGROUND, away), bare)
    sky = np.random.default_rng(0).normal(0, 0.3, (4, 3)).astype(np.float32)
    expected = to_bytes(np.clip(np.asarray(backdrop.color_behind(jnp.asarray(sky), away)), 0, 1))
    assert expected.std(axis=(0, 1)).max() > 5
    for image in (draw_picture(COLOR, SCENE, away, sky), bare_background(sky, away)):
        np.testing.assert_allclose(image.astype(int), expected.astype(int), atol=1)
