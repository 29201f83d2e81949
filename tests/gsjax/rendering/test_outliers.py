"""A wall that cameras look at side by side: what coarse views show of it, and which Gaussians hang in the air."""

import numpy as np
from small_scenes import discs

from gsjax.gaussians import take
from gsjax.rendering.coarse_depths import CoarseDepth, coarse_depth, depths_at
from gsjax.rendering.gallery import Picture
from gsjax.rendering.outliers import are_floaters
from gsjax.scene.cameras import Camera

WALL = 4.0  # Its z, with the cameras at z = 0 looking along it.
MIDDLE = (slice(14, 17), slice(18, 23))  # pixels that look straight ahead


def camera(x, width=40, height=30):
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[0, 3] = -x
    K = np.array([[30.0, 0, width / 2], [0, 30.0, height / 2], [0, 0, 1]], np.float32)
    return Camera(viewmat, K, width, height)


def view(x, depth=WALL):
    """From `x`, 40 pixels wide and 30 high: a wall at some depth."""
    return CoarseDepth(camera(x), np.full((30, 40), depth, np.float32))


def at(*means, thickness=0.02):
    """A small disc a mean that faces the cameras, with a standard deviation of `thickness` towards them."""
    return discs(np.array(means, float), np.array([0.0, 0, -1]), 0.02, thickness=thickness / 0.02)


def test_what_other_views_look_through_or_one_alone_has_near_hangs_in_the_air():
    views = [view(x) for x in (-0.5, 0.0, 0.5, 9.0)]
    views[1].depth[MIDDLE] = 0.6  # Before the middle camera alone,
    views[3].depth[MIDDLE] = 0.7  # and before one that nobody stands beside.
    expected = {
        (0.1, 0.1, WALL): False,  # on the wall
        (0.0, 0.0, 5.0): False,  # hidden behind it
        (0.0, 0.0, 0.6): True,  # shown by one, looked through by two
        (9.0, 0.0, 0.7): True,  # shown by one alone, near it
        (9.5, 0.5, WALL): False,  # shown by one alone, on the wall
        (0.0, 0.1, 2.0): True,  # in the air, and shown by none
        (0.0, 0.0, -3.0): False,  # behind the cameras
        (np.nan, 0.0, 2.0): False,
    }
    is_floater = are_floaters(at(*expected), views)
    assert dict(zip(map(str, expected), is_floater.tolist(), strict=True)) == {str(k): v for k, v in expected.items()}


def test_a_post_that_two_views_show_is_none_nor_what_is_as_thick_as_its_distance_to_the_wall():
    post = at((0.0, 0.0, 2.0))
    assert are_floaters(post, [view(-0.5), view(0.0), view(0.5)]).all()
    assert not are_floaters(post, [view(-0.5, 2.0), view(0.0, 2.0), view(0.5)]).any()
    assert not are_floaters(at((0.0, 0.0, 2.0), thickness=0.7), [view(-0.5), view(0.0), view(0.5)]).any()


def test_a_view_that_shows_nothing_says_nothing():
    both = at((0.0, 0.0, 2.0), (0.0, 0.0, WALL))
    assert not are_floaters(both, [view(0.0, 0.0)] * 3).any()
    masked = [view(-0.5), view(0.0, 0.0), view(0.5)]
    assert are_floaters(both, masked).tolist() == [True, False]
    assert are_floaters(take(both, slice(0, 0)), masked).shape == (0,)


def test_a_coarse_view_shows_a_slanted_wall_at_the_depths_of_its_pixels():
    full = camera(0.3, 97, 61)
    columns = (np.arange(97) + 0.5 - full.K[0, 2]) / full.K[0, 0]
    depth = np.broadcast_to(WALL / (1 - 0.3 * columns), (61, 97)).astype(np.float32)  # z = WALL + 0.3 x
    view = coarse_depth(full, Picture(np.zeros((61, 97, 3)), depth, np.ones((61, 97))), longest=20)
    assert view.depth.shape == (12, 19)
    x = (np.arange(19) + 0.5 - view.camera.K[0, 2]) / view.camera.K[0, 0] * view.depth[6]
    points = np.stack([x + 0.3, np.zeros(19), view.depth[6]], axis=-1)
    np.testing.assert_allclose(view.depth[6], WALL + 0.3 * x, rtol=1e-5)
    z, depths = depths_at(points, view)
    np.testing.assert_allclose(depths, z, rtol=1e-5)
    assert depths_at(points + [0, 0, 100.0] - [900.0, 0, 0], view)[1].max() == 0
