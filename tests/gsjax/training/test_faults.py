"""A loss or a gradient that is not finite ends training before it does harm: one line names term, step and photo."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, cloud, fit, photographed

from gsjax.errors import InputError
from gsjax.settings import Phase, Rates, Schedule, Settings, Weights
from gsjax.training.optimizers import make_optimizer
from gsjax.training.state import initial_state
from gsjax.training.stepping import view_order
from gsjax.training.terms import Term

ROWS, EXTENT, CAPACITY = 32, 1.0, 8192
OPTIMIZER = make_optimizer(Rates(), EXTENT, 6)


@pytest.fixture(scope="module")
def frames():
    cameras = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0)) for x in (-1.0, 0.0, 1.0)]
    return photographed(cloud(50, seed=5), cameras)


def of_camera_1(gaussians, view, batch):
    """Minus infinity for the photo of one camera, and zero with zero gradient for the others."""
    return jnp.where(jnp.abs(batch.camera.viewmat[0, 3]) < 0.1, -jnp.inf, 0.0)


def test_a_value_that_is_not_finite_stops_at_the_photo_that_has_it(frames):
    """The term is in every second step alone, whose faults are looked for among all terms."""
    faulty_step = next(step for step in range(1, 6, 2) if view_order(3, step, 3) == 1) + 1
    phases = (Phase("surface", 6, Weights(dssim=0.0, own=0.5), surface_every=2),)
    states = []
    settings, terms = Settings(seed=3, schedule=Schedule(phases=phases)), {"own": Term(of_camera_1, {"depth"})}
    state = initial_state(cloud(ROWS, seed=1), OPTIMIZER)
    how = {"observe": lambda progress: states.append(jax.tree.map(np.array, progress.state)), "capacity": CAPACITY}
    with pytest.raises(InputError) as stopped:
        fit(settings, frames, EXTENT, state, OPTIMIZER, terms, **how)
    assert str(stopped.value).startswith(f"step {faulty_step}, photo {frames[1].name}: the loss term 'own' is -inf;")
    assert [int(state.step) for state in states] == list(range(1, faulty_step))
    for state in states:
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))
