"""The rule that a phase was handed is the one that gathers, makes room and densifies; a state says that it is taken."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, cloud, photographed

from gsjax.errors import InputError
from gsjax.gaussians import DEAD_LOGIT
from gsjax.settings import Density, Model, Phase, Rates, Schedule, Settings, Weights
from gsjax.training import buffers
from gsjax.training import state as states
from gsjax.training.densification.gradient_driven import Moves
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.loop import Work, follow
from gsjax.training.optimizers import make_optimizer
from gsjax.training.plan import plan
from gsjax.training.state import count_alive, initial_state

ALIVE, ROWS, MOST = 30, 40, 160
OPTIMIZER = make_optimizer(Rates(), 1.0, 12)
PHASES = tuple(Phase(name, 6, Weights(dssim=0.0), density_control=True) for name in ("first", "second"))
SETTINGS = Settings(
    seed=3,
    schedule=Schedule(phases=PHASES),
    model=Model(max_gaussians=MOST),
    density=Density(start=1, stop=12, every=3, gradient=1e9),
)


def _target_count(gaussians, statistics, density, *, step, budget):
    return jnp.int32(2 * ALIVE)


def _doubled(gaussians, statistics, key, *, density, extent, prune_large, count):
    """The first rows again where rows are free, until there are `count`."""
    rows = jnp.arange(gaussians.num_gaussians)
    fresh = (rows >= ALIVE) & (rows < count)
    source = jnp.where(fresh, rows - ALIVE, rows)
    return jax.tree.map(lambda each: each[source], gaussians), Moves(source, fresh)


DOUBLING = DENSIFICATION_RULES["adc"]._replace(  # Under `gradient=1e9` the rule of 3DGS never grows anything.
    empty_statistics=lambda count: {"seen": jnp.zeros(count, jnp.float32)},
    accumulate=lambda sums, gradient, is_visible, distances, size: {
        "seen": sums["seen"] + is_visible.astype(jnp.float32)
    },
    wanted_count=_target_count,
    densify=_doubled,
)


def test_the_rule_of_a_phase_gathers_makes_room_and_densifies_and_the_next_begins_with_sums_of_its_own(monkeypatch):
    """So does the first phase, whose state was made for the rule of 3DGS."""
    monkeypatch.setattr(buffers, "_fewest_rows", lambda: 8)
    cameras = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0)) for x in (-1.0, 0.0, 1.0)]
    frames, planned, watched = photographed(cloud(50, seed=5), cameras), plan(SETTINGS), []
    rules = DOUBLING, DENSIFICATION_RULES["adc"]
    phases = tuple(replace(phase, rule=rule) for phase, rule in zip(planned.phases, rules, strict=True))
    work = Work(
        replace(planned, phases=phases),
        frames,
        1.0,
        OPTIMIZER,
        observe=lambda progress: watched.append(jax.tree.map(np.array, progress.state)),
    )
    follow(work, initial_state(cloud(ALIVE, capacity=ROWS, seed=1), OPTIMIZER), 8192)
    assert [int(count_alive(each.gaussians)) for each in watched[:4]] == [ALIVE, ALIVE, 2 * ALIVE, 2 * ALIVE]
    assert watched[1].statistics["seen"].max() == 2 and watched[2].statistics["seen"].max() == 0
    assert watched[1].gaussians.num_gaussians == ROWS < 2 * ALIVE <= watched[2].gaussians.num_gaussians
    assert watched[6].statistics.views.max() == 1, "after the first step of the second phase"
    assert watched[-1].statistics.views.shape == (watched[-1].gaussians.num_gaussians,)


def test_a_rule_that_is_not_known_is_named_before_anything_runs():
    with pytest.raises(InputError, match=r"^density\.rule='mine' is none of adc, error$"):
        plan(SETTINGS.replace(density=Density(rule="mine")))


def _densified(state):
    arguments = jax.random.key(0), jnp.float32(1.0), jnp.asarray(False)
    return states.densify(
        state, *arguments, optimizer=OPTIMIZER, density=Density(), budget=ROWS, rule=DENSIFICATION_RULES["adc"]
    )


@pytest.mark.parametrize(
    "change",
    [
        _densified,
        lambda state: states.reset_opacities(state, optimizer=OPTIMIZER, limit=0.01),
        lambda state: states.cull(state, optimizer=OPTIMIZER, min_opacity=0.5),
        lambda state: states.remove(state, jnp.arange(ROWS) < 5, optimizer=OPTIMIZER),
    ],
)
def test_a_changed_state_takes_the_arrays_of_the_one_before(change):
    state = jax.tree.map(jnp.array, initial_state(cloud(ALIVE, capacity=ROWS, seed=1), OPTIMIZER))
    changed = change(state)
    assert state.gaussians.means.is_deleted() and not changed.gaussians.means.is_deleted()
    with pytest.raises(RuntimeError, match="deleted"):
        np.asarray(state.gaussians.means)
    assert np.all(np.asarray(changed.gaussians.logit_opacities) >= DEAD_LOGIT)
