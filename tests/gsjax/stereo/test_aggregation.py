"""Semi-global matching against loops, and its parabola against parabolas."""

import numpy as np
import pytest
from tolerances import assert_close

from gsjax.stereo.sweep import JUMP, STEP, best_planes, smoothed


def by_loops(costs):
    """The same sum of four paths, `[H, W, D]` float64, as the paper's equation has it."""
    height, width, planes = costs.shape
    total = np.zeros(costs.shape)
    for dy, dx in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        path = np.zeros(costs.shape)
        for y in range(height)[:: -1 if dy < 0 else 1]:
            for x in range(width)[:: -1 if dx < 0 else 1]:
                before = (y - dy, x - dx)
                if not (0 <= before[0] < height and 0 <= before[1] < width):
                    path[y, x] = costs[y, x]
                    continue
                for d in range(planes):
                    ways = [path[before][d], path[before].min() + JUMP]
                    ways += [path[before][other] + STEP for other in (d - 1, d + 1) if 0 <= other < planes]
                    path[y, x, d] = costs[y, x, d] + min(ways) - path[before].min()
        total += path
    return total


@pytest.mark.parametrize("shape", [(5, 7, 6), (1, 4, 3)])
def test_costs_are_those_of_the_best_paths(shape):
    costs = np.random.default_rng(0).uniform(0, 2, shape)
    assert_close(np.asarray(smoothed(costs.astype(np.float32))), by_loops(costs))


def test_places_between_planes_are_vertices_of_parabolas():
    truth = np.array([[2.3, 2.3], [2.3, 2.3]])
    costs = 0.01 * (np.arange(6)[:, None, None] - truth) ** 2
    places, unlike = best_planes(costs.astype(np.float32))
    # All pixels have one parabola, so the paths change none of it: four times the cost and what came before.
    assert_close(places, truth.astype(np.float32), rtol=1e-4, atol=0, why="differences of close float32 numbers")
    assert_close(unlike, costs[2].astype(np.float32))
    for plane in (0, 5):
        costs = np.ones((6, 3, 3), np.float32)
        costs[plane] = 0
        np.testing.assert_array_equal(best_planes(costs)[0], plane, err_msg="the first and the last are whole")
