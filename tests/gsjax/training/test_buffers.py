from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gsjax.settings import Density, Rates
from gsjax.training import buffers
from gsjax.training.buffers import lengthen, shorten, with_room_to_densify
from gsjax.training.densification.error_driven import ErrorStatistics
from gsjax.training.densification.gradient_driven import GRADIENT, GradientStatistics
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.initialize import from_points
from gsjax.training.optimizers import apply_gradients, make_optimizer
from gsjax.training.state import count_alive, densify, initial_state, remove

OPTIMIZER = make_optimizer(Rates(), 1.0, 10)
ALIVE, SHORT, LONG = 20, 24, 64
DENSITY = {"adc": Density(), "error": Density(rule="error", start=0, stop=200, full_by=1.0)}
# The rule of errors fills 64 rows in three densifications: 20 * (64 / 20)^(1/3), rounded up, are 30.


def trained(capacity, rule):
    """A state of twenty living rows with moments and statistics, in a buffer of so many rows."""
    points = np.random.default_rng(0).normal(size=(ALIVE, 3))
    gaussians = from_points(points, np.full((ALIVE, 3), 0.4), capacity=capacity, sh_degree=1)
    state = initial_state(gaussians, OPTIMIZER, DENSIFICATION_RULES[rule])
    alive = (np.arange(capacity) < ALIVE).astype(np.float32)
    gradients = jax.tree.map(
        lambda x: jnp.asarray(alive.reshape(-1, *[1] * (x.ndim - 1)) * np.ones(x.shape, np.float32)), gaussians
    )
    moved, opt_state = apply_gradients(gaussians, state.opt_state, OPTIMIZER, gradients, jnp.bool_(False))
    rising = jnp.asarray(alive * np.arange(capacity) / ALIVE, jnp.float32)
    if rule == "adc":  # Half of the rows reach the threshold.
        statistics = GradientStatistics(2 * GRADIENT * rising, jnp.asarray(alive))
    else:
        statistics = ErrorStatistics(2 * rising, rising, jnp.asarray(alive), 3 * rising)
    return replace(state, gaussians=moved, opt_state=opt_state, statistics=statistics)


def assert_identical(actual, expected):
    jax.tree.map(np.testing.assert_array_equal, actual, expected)


def test_a_shortened_state_has_the_living_in_their_order_with_all_that_is_theirs(monkeypatch):
    monkeypatch.setattr(buffers, "FEWEST_ROWS", 8)
    monkeypatch.setattr(buffers, "ROUND", 8)
    dead = np.isin(np.arange(LONG), (0, 3, 4, 11, 19))
    state = remove(lengthen(trained(SHORT, "error"), OPTIMIZER, LONG), jnp.asarray(dead), optimizer=OPTIMIZER)
    shortened = shorten(state, OPTIMIZER, LONG)
    assert shortened.gaussians.num_gaussians == 16
    living = np.flatnonzero(~dead & (np.arange(LONG) < ALIVE))
    assert int(count_alive(shortened.gaussians)) == len(living) == 15
    by_row = [
        [x for x in jax.tree.leaves(each) if x.shape[:1] == (rows,)] for each, rows in ((state, LONG), (shortened, 16))
    ]
    assert len(by_row[0]) == len(by_row[1]) > 18 + 1, "Gaussians, two moments and statistics"
    for before, after in zip(*by_row, strict=True):
        np.testing.assert_array_equal(after[:15], np.asarray(before)[living])
        assert np.isfinite(after[15]).all()
    emptied = remove(shortened, jnp.ones(16, bool), optimizer=OPTIMIZER)
    assert shorten(emptied, OPTIMIZER, LONG).gaussians.num_gaussians == 8


@pytest.mark.parametrize("rule", DENSIFICATION_RULES)
def test_density_control_gives_the_same_bits_in_a_buffer_that_grows_as_in_one_of_the_whole_budget(monkeypatch, rule):
    monkeypatch.setattr(buffers, "FEWEST_ROWS", 8)
    key, density, how = jax.random.key(1), DENSITY[rule], {"rule": DENSIFICATION_RULES[rule]}
    short = with_room_to_densify(trained(SHORT, rule), OPTIMIZER, density, LONG, **how)
    ended = []
    for state in (short, trained(LONG, rule)):
        how |= {"optimizer": OPTIMIZER, "density": density, "budget": LONG}
        ended.append(densify(state, key, jnp.float32(1.0), jnp.asarray(False), **how))
    grown, whole = ended
    assert SHORT < grown.gaussians.num_gaussians == 32 < LONG
    assert int(count_alive(whole.gaussians)) == ALIVE + 10 > SHORT
    assert_identical(lengthen(grown, OPTIMIZER, LONG), whole)
