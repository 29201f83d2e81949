"""A step over D views on D devices against one device that takes the same views one by one."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from small_scenes import camera_at, cloud, photographed
from tolerances import assert_close

from gsjax import views
from gsjax.settings import Weights
from gsjax.training import sharding
from gsjax.training.rules import RULES
from gsjax.training.sharded_step import make_sharded_step
from gsjax.training.state import initial_state
from gsjax.training.step import BACKGROUNDS, make_train_step

ALIVE, ROWS, PAIRS, SPLATS = 60, 64, 4096, 32
SIZE = (32, 24)
EYES = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.3), (0.0, -1.0, 0.0), (0.0, 0.0, 9.0))
"""Four views; before the last there is nothing at all."""
CAMERAS = [camera_at(eye, (0.0, 0.0, 4.0) if eye[2] < 4 else (0.0, 0.0, 12.0), size=SIZE) for eye in EYES]
KEY = jax.random.key(0)

RECORDER = optax.GradientTransformation(
    lambda parameters: jax.tree.map(jnp.zeros_like, parameters),
    lambda gradients, state, parameters=None: (jax.tree.map(jnp.zeros_like, gradients), gradients),
)
"""An optimiser that moves nothing and keeps the gradient."""

PHASES = {"adc": (Weights(alpha=0.1), "adc"), "error": (Weights(alpha=0.1), "error")}
SURFACE = Weights(alpha=0.1, entropy=0.1, thickness=0.1, sdf_normal=0.2, pixel_normal=0.2, depth_normal=0.1)


@pytest.fixture(scope="module")
def data():
    found = views.views_of(photographed(cloud(80, seed=5), CAMERAS, with_mattes=True))
    normals = np.zeros((*SIZE[::-1], 3), np.int8)
    normals[..., 2] = -views.NORMAL_UNIT
    return views.with_normals(found, [normals] * 4)


def start(rule):
    return initial_state(cloud(ALIVE, capacity=ROWS, seed=1), RECORDER, RULES[rule])


def options(rule, weights, growing=True):
    return {
        "optimizer": RECORDER,
        "weights": weights,
        "capacity": PAIRS,
        "background": BACKGROUNDS["random"],
        "sh_every": 2,
        "rule": RULES[rule] if growing else None,
        "extent": 2.0,
    }


def one_by_one(rule, weights, data, growing=True):
    """Losses, mean gradient and statistics of one device that takes all views from the same state."""
    step = make_train_step(**options(rule, weights, growing))
    state, losses, gradients = start(rule), [], []
    for target in data.targets:
        state, metrics = step(replace(state, step=jnp.int32(3)), target, KEY)
        losses.append({"loss": metrics.loss, "psnr": metrics.psnr, **metrics.terms})
        gradients.append(jax.tree.map(np.array, state.opt_state))
    mean = jax.tree.map(lambda *leaves: np.mean(np.stack(leaves).astype(np.float64), axis=0), *gradients)
    losses = jax.tree.map(lambda *each: np.mean([float(one) for one in each]), *losses)
    return SimpleNamespace(losses=losses, gradients=mean, statistics=jax.tree.map(np.array, state.statistics))


def stacked(data, mesh, count=4):
    sharding_ = jax.NamedSharding(mesh, sharding.BY_ROWS)
    return jax.tree.map(lambda *leaves: jax.device_put(np.stack(leaves), sharding_), *data.targets[:count])


def together(rule, weights, data, num_devices, splat_capacity=SPLATS, growing=True):
    mesh = sharding.mesh_of(jax.devices()[:num_devices])
    step = make_sharded_step(**options(rule, weights, growing), mesh=mesh, splat_capacity=splat_capacity)
    state = sharding.dealt(replace(start(rule), step=jnp.int32(3)), mesh)
    state, metrics, exchange = step(state, stacked(data, mesh), KEY)
    return sharding.gathered(state, mesh), jax.tree.map(np.asarray, metrics), jax.tree.map(np.asarray, exchange)


@pytest.mark.parametrize(
    ("rule", "weights", "growing", "counts"),
    [
        ("adc", Weights(alpha=0.1), True, (2, 4)),
        ("error", Weights(alpha=0.1), True, (4,)),
        ("error", SURFACE, False, (4,)),
    ],
    ids=["adc", "error", "surface"],
)
def test_a_step_over_four_views_is_that_of_one_device(data, rule, weights, growing, counts):
    expected = one_by_one(rule, weights, data, growing)
    for num_devices in counts:
        state, metrics, exchange = together(rule, weights, data, num_devices, growing=growing)
        assert not metrics.overflowed and not exchange.overflowed
        assert int(state.step) == 4
        assert_close({"loss": metrics.loss, "psnr": metrics.psnr, **metrics.terms}, expected.losses)
        assert_close(state.opt_state, expected.gradients, kind="gradient")
        assert_close(state.statistics, expected.statistics, kind="gradient")
        assert np.any(state.statistics.views) == growing
