"""The table of the nearest: who stands in it."""

import numpy as np
from small_scenes import cloud
from terms import surroundings

from gsjax.gaussians import is_alive

ALIVE, ROWS = 30, 40


def test_the_nearest_are_the_living_by_distance_itself_first():
    gaussians = cloud(ALIVE, capacity=ROWS, seed=1)
    table = surroundings.nearest(np.asarray(gaussians.means), np.asarray(is_alive(gaussians)))
    assert (table.shape, table.dtype) == ((ROWS, surroundings.NEAREST), np.int32)
    means = np.asarray(gaussians.means, np.float64)[:ALIVE]
    expected = np.argsort(np.linalg.norm(means[:, None] - means, axis=-1), axis=1)[:, : surroundings.NEAREST]
    np.testing.assert_array_equal(table[:ALIVE], expected)
    np.testing.assert_array_equal(table[ALIVE:], surroundings.none_yet(ROWS)[ALIVE:])
