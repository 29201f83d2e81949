"""The table of the nearest: who stands in it, when another is made, and that a run trains with it."""

import numpy as np
import pytest
from photographed_wall import wall
from small_scenes import cloud, plane
from terms import make_terms, surroundings
from terms.surroundings import Surroundings

from gsjax.gaussians import is_alive
from gsjax.settings import Model, Phase, Rates, Schedule, Settings, Weights
from gsjax.training import loop
from gsjax.training.optimizers import make_optimizer
from gsjax.training.state import initial_state

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


@pytest.mark.long  # terms that studies alone hand in
def test_a_run_trains_with_both_terms_and_draws_other_points_in_every_step():
    weights = Weights(l1=0.0, dssim=0.0, alpha=0.0, sugar_sdf=0.1, sugar_density=0.2)
    settings = Settings(schedule=Schedule(phases=(Phase("surface", 3, weights),)), model=Model(max_gaussians=ROWS))
    optimizer, losses = make_optimizer(Rates(), 1.0, 8), []
    loop.fit(
        settings,
        wall(2).frames,
        1.0,
        initial_state(plane((0.0, 0.0, -1.0), per_side=6, spacing=0.25, radius=0.2), optimizer),
        optimizer,
        prior=lambda _: [],
        observe=lambda progress: losses.append({name: float(loss) for name, loss in progress.metrics.terms.items()}),
        terms=make_terms(lambda: 1.0),
        capacity=4096,
    )
    assert all(0 < loss[name] < 9 for loss in losses for name in ("sugar_sdf", "sugar_density"))
    assert len({loss["sugar_density"] for loss in losses}) == 3
