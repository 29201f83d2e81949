"""The table of the nearest: who stands in it, and that a run with it stops and goes on to the same numbers."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from photographed_wall import wall
from small_scenes import cloud
from terms import TERMS, surroundings

from gsjax.settings import Density, Phase, Rates, Settings, Weights
from gsjax.training import loop
from gsjax.training.buffers import lengthen
from gsjax.training.optimizers import make_optimizer
from gsjax.training.plan import plan
from gsjax.training.state import initial_state
from gsjax.training.step import Metrics

ALIVE, ROWS = 30, 40


def test_the_nearest_are_the_living_by_distance_itself_first():
    gaussians = cloud(ALIVE, capacity=ROWS, seed=1)
    table = surroundings.nearest(gaussians)
    assert (table.shape, table.dtype) == ((ROWS, surroundings.NEAREST), np.int32)
    means = np.asarray(gaussians.means, np.float64)[:ALIVE]
    expected = np.argsort(np.linalg.norm(means[:, None] - means, axis=-1), axis=1)[:, : surroundings.NEAREST]
    np.testing.assert_array_equal(table[:ALIVE], expected)
    np.testing.assert_array_equal(table[ALIVE:], surroundings.none_yet(ROWS)[ALIVE:])


@pytest.mark.parametrize("alive", [0, 1, 5])
def test_where_there_are_few_the_own_id_stands_for_nobody(alive):
    table = surroundings.nearest(cloud(alive, capacity=8))
    assert np.all(np.sort(table[:alive, :alive], axis=1) == np.arange(alive))
    assert np.all(table[:, max(alive, 1) :] == np.arange(8)[:, None])


def test_of_coincident_gaussians_each_is_its_own_first():
    gaussians = replace(cloud(20), means=jnp.ones((20, 3)))
    np.testing.assert_array_equal(surroundings.nearest(gaussians)[:, 0], np.arange(20))


OPTIMIZER = make_optimizer(Rates(), 1.0, 8)
PHASES = (Phase("plain", 1, Weights(alpha=0.0)), Phase("surface", 6, Weights(alpha=0.0, sugar_density=0.2)))


def start():
    table = jnp.asarray(surroundings.none_yet(ROWS))
    return initial_state(cloud(ALIVE, capacity=ROWS, seed=1), OPTIMIZER, tables={"nearest": table})


def table(state):
    return state.tables["nearest"]


def shaken(state, target, key):
    """A step that moves every Gaussian somewhere else."""
    noise = np.random.default_rng(int(state.step)).normal(size=(ROWS, 3)).astype(np.float32)
    gaussians = replace(state.gaussians, means=state.gaussians.means + noise)
    return replace(state, gaussians=gaussians, step=state.step + 1), Metrics(0.0, 0.0, 0, False, {})


def fitted(state, monkeypatch):
    """The states after every step."""
    monkeypatch.setattr(loop, "REFRESHED_EVERY", 5)
    monkeypatch.setattr(loop, "kept_step", lambda *_, **__: shaken)
    monkeypatch.setattr(loop, "chosen_capacity", lambda *_, **__: 4096)
    states = []
    loop.fit(
        Settings(phases=PHASES, max_gaussians=ROWS),
        wall(2).frames,
        1.0,
        state,
        OPTIMIZER,
        prior=lambda _: [],
        observe=lambda progress: states.append(progress.state),
        terms=TERMS,
        capacity=4096,
    )
    return states


def test_a_run_makes_the_table_anew_when_due_and_goes_on_from_a_checkpoint_to_the_same_bits(monkeypatch):
    whole = fitted(start(), monkeypatch)
    np.testing.assert_array_equal(table(whole[0]), table(start()))
    # At the start of the phase that reads it, and every 5 steps.
    for made, kept in ((1, (2, 3, 4)), (5, (5, 6, 7))):
        of_then = surroundings.nearest(whole[made - 1].gaussians)
        for step in kept:
            np.testing.assert_array_equal(table(whole[step - 1]), of_then)
    assert np.any(table(whole[3]) != table(whole[4]))
    resumed = fitted(whole[5], monkeypatch)
    jax.tree.map(np.testing.assert_array_equal, resumed[-1], whole[-1])


def test_other_gaussians_ask_for_another_table():
    settings = Settings(
        density=Density(start=1, stop=600, every=200), phases=(Phase("a", 9, density_control=True), Phase("b", 9))
    )
    planned = plan(settings)
    growing, still = planned.phases
    due = [step for step in range(1, 1001) if loop._moves_neighbors(planned, growing, step)]
    assert due == [9, 200, 400, 500, 1000], "at 9 growth ends, and shortened buffers have other rows"
    assert not loop._moves_neighbors(planned, still, 200)


def test_longer_buffers_have_a_row_of_the_table_each():
    longer = table(lengthen(start(), OPTIMIZER, ROWS + 9))
    np.testing.assert_array_equal(longer[:ROWS], surroundings.none_yet(ROWS))
    assert longer.shape == (ROWS + 9, surroundings.NEAREST)
