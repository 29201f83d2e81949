"""The table of the nearest: who stands in it, when another is made, and that a run trains with it."""

import numpy as np
from small_scenes import cloud
from terms import surroundings
from terms.surroundings import Surroundings

from gsjax.gaussians import is_alive

ALIVE, ROWS = 30, 40


def arrays(gaussians):
    return np.asarray(gaussians.means), np.asarray(is_alive(gaussians))


def nearest(gaussians):
    return surroundings.nearest(*arrays(gaussians))


def test_the_nearest_are_the_living_by_distance_itself_first():
    gaussians = cloud(ALIVE, capacity=ROWS, seed=1)
    table = nearest(gaussians)
    assert (table.shape, table.dtype) == ((ROWS, surroundings.NEAREST), np.int32)
    means = np.asarray(gaussians.means, np.float64)[:ALIVE]
    expected = np.argsort(np.linalg.norm(means[:, None] - means, axis=-1), axis=1)[:, : surroundings.NEAREST]
    np.testing.assert_array_equal(table[:ALIVE], expected)
    np.testing.assert_array_equal(table[ALIVE:], surroundings.none_yet(ROWS)[ALIVE:])


def test_another_table_is_made_every_500_looks_and_for_other_gaussians():
    first, moved = (arrays(cloud(ALIVE, capacity=ROWS, seed=seed)) for seed in (1, 2))
    around = Surroundings(lambda: 1.0)
    tables = [around.look(*first), *(around.look(*moved) for _ in range(500))]
    for table in tables[:500]:
        np.testing.assert_array_equal(table, surroundings.nearest(*first))
    np.testing.assert_array_equal(tables[500], surroundings.nearest(*moved))
    for other in (cloud(ALIVE - 1, capacity=ROWS, seed=1), cloud(ALIVE, capacity=ROWS + 9, seed=1)):
        np.testing.assert_array_equal(around.look(*arrays(other)), nearest(other))
