"""A slanted wall, against the depths that a coarse view of it shows."""

import numpy as np

from gsjax.rendering.coarse_depths import coarse_depth, depths_at
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera

WALL = 4.0  # Its z, with the cameras at z = 0 looking along it.


def camera(x, width=40, height=30):
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[0, 3] = -x
    K = np.array([[30.0, 0, width / 2], [0, 30.0, height / 2], [0, 0, 1]], np.float32)
    return Camera(viewmat, K, width, height)


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
