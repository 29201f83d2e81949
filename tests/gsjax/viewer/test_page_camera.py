"""The browser's camera and ours: one and the same view, whatever the page's shape."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scenes import camera_at
from tolerances import assert_close

from gsjax.scene.cameras import Camera
from gsjax.viewer.page_camera import FOVS, PageCamera, camera_of, page_camera

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
