"""The study of the middle of a scene knows which pixels show it."""

import numpy as np
import pytest

from gsjax.cameras import look_at
from gsjax.scene import Pixels, frame_of


@pytest.fixture
def study(scripts):
    return scripts("inside")


def test_a_pixel_is_inside_where_its_surface_point_is_near_the_middle(study):
    # From 10 above the ground with a focal length of 20 pixels, one pixel is half a unit of ground.
    viewmat = look_at(np.array([0.0, 0, 10]), np.zeros(3), np.array([0.0, 1, 0]))
    K = np.array([[20, 0, 16], [0, 20, 12], [0, 0, 1]], np.float32)
    frame = frame_of("a.png", viewmat, K, Pixels(np.zeros((24, 32, 3), np.uint8)))
    depth = np.full((24, 32), 10, np.float32)
    depth[:, :16] = 0  # sky
    x, y = 0.5 * (np.arange(32) + 0.5 - 16), 0.5 * (np.arange(24) + 0.5 - 12)
    expected = (np.abs(y)[:, None] <= 2) & (np.abs(x) <= 2) & (np.arange(32) >= 16)
    assert 0 < expected.sum() < 100
    np.testing.assert_array_equal(study.inside(frame, depth, 2.0), expected)
