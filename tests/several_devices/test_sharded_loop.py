"""Whole runs on several devices against the same run on one of them."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, cloud, photographed
from tolerances import assert_close

from gsjax.settings import Density, Phase, Rates, Settings, Weights
from gsjax.training.buffers import with_room_to_densify
from gsjax.training.growth import adaptive
from gsjax.training.growth.rules import RULES
from gsjax.training.initialize import DEAD_LOGIT
from gsjax.training.loop import Work, follow
from gsjax.training.optimizers import make_optimizer, map_moments
from gsjax.training.plan import plan
from gsjax.training.sharded import growth as sharded_density
from gsjax.training.sharded import layout as sharding
from gsjax.training.sharded import placement as several
from gsjax.training.state import count_alive, densify, initial_state

PLAIN = Weights(dssim=0.0)
EXTENT, ALIVE, CAPACITY, VIEWS = 1.0, 30, 48, 4
SETTINGS = Settings(
    seed=3,
    background="random",
    phases=(Phase("coarse", 6, PLAIN, image_scale=2, density_control=True, cull_below=0.6),),
    sh_every=4,
    max_gaussians=CAPACITY,
    density=Density(start=1, stop=6, every=2, gradient=1e-6, reset_every=5, min_opacity=0.01),
)
ROUNDED = {"atol": 2e-3, "rtol": 1e-3, "why": "Adam divides what rounding left of a small gradient by itself"}
OPTIMIZER = make_optimizer(Rates(), EXTENT, 6)


@pytest.fixture(scope="module", autouse=True)
def high_reset():
    """Opacities are reset to what leaves some of these few steps' Gaussians above the cull."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(adaptive, "RESET_OPACITY", 0.7)
        yield


@pytest.fixture(scope="module")
def frames():
    cameras = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0)) for x in (-1.0, 0.0, 1.0)]
    return photographed(cloud(50, seed=5), cameras, with_mattes=True)


def fitted(frames, num_devices, *, settings=SETTINGS, state=None, capacity=None):
    mesh = sharding.mesh_of(jax.devices()[:num_devices])
    told = []

    def observe(progress):
        told.append(progress._replace(state=sharding.gather_rows(progress.state, mesh)))

    if state is None:
        state = initial_state(cloud(ALIVE, capacity=CAPACITY, seed=1), OPTIMIZER, RULES[settings.density.rule])
    normals = [np.tile(np.int8([12, 25, -124]), (24, 32, 1))] * 3
    work = Work(
        plan(settings),
        frames,
        EXTENT,
        OPTIMIZER,
        lambda state: normals,
        observe,
        placement=several.placement(mesh, VIEWS),
    )
    final = follow(work, sharding.deal_rows(state, mesh), capacity)
    return SimpleNamespace(final=sharding.gather_rows(final, mesh), told=told)


@pytest.fixture(scope="module")
def runs(frames):
    return {count: fitted(frames, count) for count in (2, 4)}


@pytest.mark.long
def test_gaussians_are_the_same_on_any_number_of_devices(runs):
    alive = {count: [int(count_alive(told.state.gaussians)) for told in run.told] for count, run in runs.items()}
    assert alive[2] == alive[4]
    assert ALIVE < alive[4][4] <= CAPACITY and alive[4][5] < alive[4][4]
    assert_close(runs[2].final.gaussians, runs[4].final.gaussians, **ROUNDED)


@pytest.mark.long
def test_a_run_that_stopped_goes_on_with_another_number_of_devices(frames, runs):
    begun = jax.tree.map(jnp.asarray, runs[4].told[3].state)
    resumed = fitted(frames, 2, state=begun, capacity=64)
    assert [told.step for told in resumed.told] == [5, 6]
    assert_close(resumed.final.gaussians, runs[4].final.gaussians, **ROUNDED)


@pytest.mark.long
def test_steps_of_the_surface_see_smaller_photos_on_any_number_of_devices(frames):
    surface = Phase("surface", 4, Weights(dssim=0.0, pixel_normal=0.2), surface_every=2, surface_scale=2)
    settings = replace(SETTINGS, phases=(surface,))
    fits = {count: fitted(frames, count, settings=settings) for count in (2, 4)}
    taken = [["pixel_normal" in told.metrics.terms for told in fit.told] for fit in fits.values()]
    assert taken == [[False, True, False, True]] * 2
    assert_close(fits[2].final.gaussians, fits[4].final.gaussians, **ROUNDED)


@pytest.mark.parametrize("rule", RULES)
def test_a_densification_by_rows_is_that_of_one_device(rule):
    """The same bits: the rule sees the same numbers in the same order, births and their colours cross devices."""
    mesh = sharding.mesh_of(jax.devices()[:4])
    rng = np.random.default_rng(0)
    state = initial_state(cloud(ALIVE, capacity=CAPACITY, seed=1), OPTIMIZER, RULES[rule])
    state = jax.tree.map(lambda x: x + 1 if x.ndim == 0 else x, state)
    full = jax.tree.map(lambda x: jnp.asarray(rng.uniform(0.1, 1, x.shape), jnp.float32), state.statistics)
    moments = map_moments(OPTIMIZER, lambda x: jnp.asarray(rng.normal(size=x.shape), jnp.float32), state.opt_state)
    state = replace(state, statistics=full, opt_state=moments)
    density = Density(rule=rule, start=0, stop=2, every=2, gradient=0.2, dense_share=0.25, max_share=9.0)
    arguments = jax.random.key(1), jnp.float32(EXTENT), jnp.asarray(False)
    how = {"optimizer": OPTIMIZER, "density": density, "budget": CAPACITY}
    by_rows = sharded_density.densify(sharding.deal_rows(state, mesh), *arguments, mesh=mesh, **how)
    alive = [
        int((part > 0.5 * DEAD_LOGIT).sum()) for part in np.split(np.asarray(by_rows.gaussians.logit_opacities), 4)
    ]
    assert max(alive) - min(alive) <= 1 and sum(alive) > ALIVE
    expected = densify(state, *arguments, **how)
    jax.tree.map(np.testing.assert_array_equal, sharding.gather_rows(by_rows, mesh), jax.tree.map(np.asarray, expected))


def test_buffers_grow_by_rows_as_on_one_device():
    mesh = sharding.mesh_of(jax.devices()[:4])
    state = initial_state(cloud(ALIVE, capacity=32, seed=1), OPTIMIZER, RULES["error"])
    density = Density(rule="error", start=0, stop=2, every=2)
    by_rows = sharded_density.with_room_to_densify(sharding.deal_rows(state, mesh), OPTIMIZER, density, 48, mesh=mesh)
    expected = with_room_to_densify(state, OPTIMIZER, density, 48)
    assert expected.gaussians.num_gaussians == 48
    jax.tree.map(np.testing.assert_array_equal, sharding.gather_rows(by_rows, mesh), jax.tree.map(np.asarray, expected))
