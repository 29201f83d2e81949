"""A step over D views on D devices against one device that takes the same views one by one."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from small_scenes import camera_at, cloud, photographed
from tolerances import assert_close

from gsjax.scene import batches
from gsjax.settings import Weights
from gsjax.training.growth.rules import RULES
from gsjax.training.initialize import DEAD_LOGIT
from gsjax.training.sharded import layout as sharding
from gsjax.training.sharded.step import make_sharded_step
from gsjax.training.state import initial_state
from gsjax.training.step import BACKGROUNDS, make_train_step
from gsjax.training.terms import weigh_terms

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

SURFACE = weigh_terms(
    Weights(alpha=0.1, entropy=0.1, thickness=0.1, sdf_normal=0.2, pixel_normal=0.2, depth_normal=0.1)
)
CASES = {"adc": (weigh_terms(Weights(alpha=0.1)), 2), "error": (SURFACE, 4)}
"""The terms and the devices that a rule is tested with: two views for each, and a view for each with everything on."""


@pytest.fixture(scope="module")
def data():
    found = batches.read_targets(photographed(cloud(80, seed=5), CAMERAS, with_mattes=True))
    normals = np.zeros((*SIZE[::-1], 3), np.int8)
    normals[..., 2] = -batches.NORMAL_UNIT
    return batches.with_normals(found, [normals] * 4)


def start(rule, gaussians):
    copied = jax.tree.map(jnp.copy, gaussians)  # A step takes the buffers of its state.
    return replace(initial_state(copied, RECORDER, RULES[rule]), step=jnp.int32(3))


def options(rule):
    return {
        "optimizer": RECORDER,
        "terms": CASES[rule][0],
        "capacity": PAIRS,
        "background": BACKGROUNDS["random"],
        "sh_every": 2,
        "rule": RULES[rule],
        "depth_mode": "front",
        "extent": 2.0,
    }


@cache
def one_device(rule):
    return make_train_step(**options(rule))


@cache
def several_devices(rule, splat_capacity=SPLATS):
    mesh = sharding.mesh_of(jax.devices()[: CASES[rule][1]])
    return mesh, make_sharded_step(**options(rule), mesh=mesh, splat_capacity=splat_capacity)


def one_by_one(rule, gaussians, data):
    """Losses, mean gradient and statistics of one device that takes all views from the same state."""
    state, losses, gradients = start(rule, gaussians), [], []
    for target in data.targets:
        state, metrics = one_device(rule)(replace(state, step=jnp.int32(3)), target, KEY)
        losses.append({"loss": metrics.loss, "psnr": metrics.psnr, **metrics.terms})
        gradients.append(jax.tree.map(np.array, state.opt_state))
    mean = jax.tree.map(lambda *leaves: np.mean(np.stack(leaves).astype(np.float64), axis=0), *gradients)
    losses = jax.tree.map(lambda *each: np.mean([float(one) for one in each]), *losses)
    return SimpleNamespace(losses=losses, gradients=mean, statistics=jax.tree.map(np.array, state.statistics))


def together(rule, gaussians, data, **more):
    mesh, step = several_devices(rule, **more)
    by_device = jax.NamedSharding(mesh, sharding.BY_ROWS)
    targets = jax.tree.map(lambda *leaves: jax.device_put(np.stack(leaves), by_device), *data.targets)
    state, metrics, exchange = step(sharding.deal_rows(start(rule, gaussians), mesh), targets, KEY)
    return sharding.gather_rows(state, mesh), jax.tree.map(np.asarray, metrics), jax.tree.map(np.asarray, exchange)


def on_first_device_alone(rule):
    """The living of the scene in the rows of one device; the rows of the others are free."""
    count = CASES[rule][1]
    gaussians = cloud(ROWS, seed=1)
    kept = jnp.arange(ROWS) % count == 0
    return replace(gaussians, logit_opacities=jnp.where(kept, gaussians.logit_opacities, DEAD_LOGIT))


@pytest.mark.parametrize("rule", ["adc", pytest.param("error", marks=pytest.mark.long)])
@pytest.mark.parametrize("rows", ["spread", "one_device"])
def test_a_step_over_four_views_is_that_of_one_device(data, rule, rows):
    gaussians = cloud(ALIVE, capacity=ROWS, seed=1) if rows == "spread" else on_first_device_alone(rule)
    expected = one_by_one(rule, gaussians, data)
    state, metrics, exchange = together(rule, gaussians, data)
    assert not metrics.overflowed and not exchange.overflowed
    assert int(state.step) == 4
    assert_close({"loss": metrics.loss, "psnr": metrics.psnr, **metrics.terms}, expected.losses)
    assert_close(state.opt_state, expected.gradients, kind="gradient")
    assert_close(state.statistics, expected.statistics, kind="gradient")
    assert np.any(state.statistics.views)
    assert np.any(state.opt_state.sh_rest) and np.any(state.opt_state.means)


def test_an_exchange_that_overflows_leaves_every_bit_and_says_what_it_needs(data):
    gaussians = cloud(ALIVE, capacity=ROWS, seed=1)
    _, _, enough = together("adc", gaussians, data)
    state, _, exchange = together("adc", gaussians, data, splat_capacity=8)
    assert exchange.overflowed and int(exchange.needed) == int(enough.needed) > 8
    jax.tree.map(np.testing.assert_array_equal, state, jax.tree.map(np.asarray, start("adc", gaussians)))
