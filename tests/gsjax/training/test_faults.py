"""A loss or a gradient that is not finite ends training before it does harm: one line names term, step and photo."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, cloud, photographed

from gsjax.errors import InputError
from gsjax.settings import Density, Phase, Rates, Schedule, Settings, Weights
from gsjax.training.loop import fit
from gsjax.training.optimizers import make_optimizer
from gsjax.training.state import initial_state
from gsjax.training.stepping import view_order
from gsjax.training.terms import Term

ROWS, EXTENT, CAPACITY = 32, 1.0, 8192
OPTIMIZER = make_optimizer(Rates(), EXTENT, 6)
DENSITY = Density(start=100, stop=200)


@pytest.fixture(scope="module")
def frames():
    cameras = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0)) for x in (-1.0, 0.0, 1.0)]
    return photographed(cloud(50, seed=5), cameras)


def norm_at_zero(gaussians, view, batch):
    """Zero, with a gradient that is NaN."""
    return jnp.linalg.norm(view.colors - jax.lax.stop_gradient(view.colors), axis=-1).mean()


def of_camera_1(gaussians, view, batch):
    """Minus infinity for the photo of one camera, and zero with zero gradient for the others."""
    return jnp.where(jnp.abs(batch.camera.viewmat[0, 3]) < 0.1, -jnp.inf, 0.0)


def trained(frames, own, *, phases=None):
    """A training of six steps; its states after each, as numpy arrays."""
    states = []
    phases = phases or (Phase("plain", 6, Weights(l1=0.0, dssim=0.0, own=0.5), density_control=True),)
    settings = Settings(seed=3, schedule=Schedule(phases=phases), density=DENSITY)
    state = initial_state(cloud(ROWS, seed=1), OPTIMIZER)
    watch = {
        "prior": lambda state: [],
        "observe": lambda progress: states.append(jax.tree.map(np.array, progress.state)),
    }
    terms = {"own": Term(own, {"depth"})}
    with pytest.raises(InputError) as stopped:
        fit(settings, frames, EXTENT, state, OPTIMIZER, capacity=CAPACITY, terms=terms, **watch)
    return SimpleNamespace(line=str(stopped.value), states=states)


def test_a_value_that_is_not_finite_stops_at_the_photo_that_has_it(frames):
    step = next(step for step in range(6) if view_order(3, step, 3) == 1) + 1
    stopped = trained(frames, of_camera_1)
    assert stopped.line.startswith(f"step {step}, photo {frames[1].name}: the loss term 'own' is -inf;")
    assert [int(state.step) for state in stopped.states] == list(range(1, step))
    for state in stopped.states:
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))


def test_the_term_of_a_step_that_has_the_dear_ones_is_found_among_these(frames):
    """The others have no depth to look at, and are not at fault."""
    phases = (Phase("surface", 6, Weights(dssim=0.0, own=0.5), surface_every=2),)
    stopped = trained(frames, norm_at_zero, phases=phases)
    name = frames[view_order(3, 1, 3)].name
    assert stopped.line.startswith(f"step 2, photo {name}: the gradient of the loss term 'own' is not finite;")
    assert len(stopped.states) == 1
