"""The Gaussians around a ray: what was hit, what is near, what is large; and walls that would lose their rays."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree
from small_scenes import discs

from gsjax.gaussians import Gaussians
from gsjax.meshing import level_set
from gsjax.meshing.knn import nearest_table
from gsjax.meshing.level_set import LevelSetOptions
from gsjax.rendering import gallery
from gsjax.scene.cameras import Camera

WALL = Camera(
    np.eye(4, dtype=np.float32) + np.float32([[0] * 4, [0] * 4, [0, 0, 0, 2], [0] * 4]),
    np.float32([[60, 0, 32], [0, 60, 32], [0, 0, 1]]),
    64,
    64,
)
"""Two units in front of the plane z = 0, of which it sees about one unit to either side."""


def sheets(centers, radii) -> Gaussians:
    """Flat discs that lie in planes of constant z."""
    scales = np.stack([radii, radii, np.full(len(centers), 1e-3)], -1)
    return replace(discs(centers, (0, 0, 1.0), 1.0), log_scales=jnp.log(jnp.asarray(scales, jnp.float32)))


def wall(small: int) -> Gaussians:
    """One large disc at z = 0 with small ones just in front of it, and others behind the camera: always 201."""
    xy = np.random.default_rng(0).uniform(-1, 1, (200, 2))
    centers = np.r_[[[0.0, 0, 0]], np.c_[xy, np.where(np.arange(200) < small, -0.002, -9)]]
    return sheets(centers, np.r_[3.0, np.full(200, 0.03)])


@pytest.mark.parametrize("small", [40, 200])
def test_a_wall_crosses_whatever_lies_on_it(small):
    gaussians = wall(small)
    pictures = list(gallery.pictures(gaussians, [WALL], np.zeros(3), with_owners=True))
    surface = level_set.surface_points(gaussians, [WALL], pictures, LevelSetOptions(num_points=4096))
    assert surface.rays == 64 * 64
    assert surface.crossing_share > 0.99
    assert np.abs(surface.points[:, 2]).max() < 0.01
    assert np.abs(surface.normals[:, 2]).min() > 0.997  # 0.9977 measured, on the rims of small discs


def test_fewer_gaussians_than_neighbours():
    assert sorted(nearest_table(KDTree(np.eye(3)), 16)[0]) == [0, 1, 2]
    assert nearest_table(KDTree(np.zeros((1, 3))), 16).tolist() == [[0]]
