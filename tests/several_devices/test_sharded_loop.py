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
from gsjax.training import several, sharding
from gsjax.training.loop import fit
from gsjax.training.optimizers import make_optimizer
from gsjax.training.rules import RULES
from gsjax.training.state import count_alive, initial_state

PLAIN = Weights(dssim=0.0)
EXTENT, ALIVE, CAPACITY, VIEWS = 1.0, 30, 48, 4
SETTINGS = Settings(
    seed=3,
    background="random",
    phases=(
        Phase("coarse", 6, PLAIN, image_scale=2, density_control=True, cull_below=0.6),
        Phase("surface", 3, replace(PLAIN, entropy=0.1, sdf_normal=0.2)),
    ),
    sh_every=4,
    max_gaussians=CAPACITY,
    density=Density(start=1, stop=6, every=2, gradient=1e-6, reset_every=5, reset_opacity=0.7, min_opacity=0.01),
)
OPTIMIZER = make_optimizer(Rates(), EXTENT, 9)


@pytest.fixture(scope="module")
def frames():
    cameras = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0)) for x in (-1.0, 0.0, 1.0)]
    return photographed(cloud(50, seed=5), cameras, with_mattes=True)


def fitted(frames, num_devices, *, settings=SETTINGS, state=None, capacity=None):
    mesh = sharding.mesh_of(jax.devices()[:num_devices])
    told = []

    def observe(progress):
        told.append(progress._replace(state=sharding.gathered(progress.state, mesh)))

    if state is None:
        state = initial_state(cloud(ALIVE, capacity=CAPACITY, seed=1), OPTIMIZER, RULES[settings.density.rule])
    final = fit(
        settings,
        frames,
        EXTENT,
        sharding.dealt(state, mesh),
        OPTIMIZER,
        prior=lambda state: [np.tile(np.int8([12, 25, -124]), (24, 32, 1))] * 3,
        observe=observe,
        capacity=capacity,
        placement=several.placement(mesh, VIEWS),
    )
    return SimpleNamespace(final=sharding.gathered(final, mesh), told=told)


@pytest.fixture(scope="module")
def runs(frames):
    return {count: fitted(frames, count) for count in (1, 2, 4)}


def test_gaussians_are_the_same_on_any_number_of_devices(runs):
    for count in (2, 4):
        for one, several_ in zip(runs[1].told, runs[count].told, strict=True):
            assert int(count_alive(one.state.gaussians)) == int(count_alive(several_.state.gaussians))
        assert_close(
            runs[count].final.gaussians,
            runs[1].final.gaussians,
            atol=2e-3,
            rtol=1e-3,
            why="Adam divides rounding of the first gradients by itself",
        )


def test_a_run_that_stopped_goes_on_with_another_number_of_devices(frames, runs):
    begun = jax.tree.map(jnp.asarray, runs[4].told[3].state)
    resumed = fitted(frames, 2, state=begun, capacity=64)
    assert [p.step for p in resumed.told] == list(range(5, 10))
    assert_close(
        resumed.final.gaussians, runs[4].final.gaussians, atol=2e-3, rtol=1e-3, why="as between numbers of devices"
    )
