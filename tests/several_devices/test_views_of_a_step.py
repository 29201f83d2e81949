"""A step whose views two devices share, against one device that takes the same views one by one."""

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

from gsjax.effects import exposure, transients
from gsjax.errors import InputError
from gsjax.scene import batches
from gsjax.settings import Density, Model, Phase, Rates, Schedule, Settings, Weights
from gsjax.training import data_parallel
from gsjax.training.data_parallel import device_mesh
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.loop import Work, follow
from gsjax.training.optimizers import make_optimizer
from gsjax.training.plan import plan
from gsjax.training.state import count_alive, initial_state
from gsjax.training.step import BACKGROUNDS, make_train_step
from gsjax.training.stepping import several_views, view_order
from gsjax.training.terms import weigh_terms
from gsjax.training.terms.multi_view import draw_neighbor, with_neighbors

ALIVE, ROWS, PAIRS, EXTENT = 60, 64, 4096, 2.0
SIZE = (32, 24)
EYES = ((0.0, 0.0, 0.0), (0.4, 0.0, 0.1), (0.0, -0.4, 0.0), (0.0, 0.0, 9.0))
"""Four views; before the last there is nothing at all."""
CAMERAS = [camera_at(eye, (0.0, 0.0, 4.0) if eye[2] < 4 else (0.0, 0.0, 12.0), size=SIZE) for eye in EYES]
KEY = jax.random.key(0)
ROUNDED = {"atol": 2e-3, "rtol": 1e-3, "why": "Adam divides what rounding left of a small gradient by itself"}
RECORDER = optax.GradientTransformation(
    lambda parameters: jax.tree.map(jnp.zeros_like, parameters),
    lambda gradients, state, parameters=None: (jax.tree.map(jnp.zeros_like, gradients), gradients),
)
"""An optimiser that moves nothing and keeps the gradient."""

SURFACE = weigh_terms(Weights(dssim=0.0, pixel_normal=0.2, multi_view=0.1))
CASES = {"adc": (weigh_terms(Weights()), False), "error": (SURFACE, True)}
"""The terms that a rule is tested with, and whether effects are simulated."""


@cache
def data_set():
    views = batches.read_batches(photographed(cloud(80, seed=5), CAMERAS, with_mattes=True))
    normals = np.zeros((*SIZE[::-1], 3), np.int8)
    normals[..., 2] = -batches.NORMAL_UNIT
    return with_neighbors(batches.with_photo_numbers(batches.with_normals(views, [normals] * 4)), EXTENT)


def views():
    """The four views, each with its nearest neighbour."""
    data = data_set()
    nearest = data.neighbors[:, 0]
    return [replace(target, neighbor=data.views[view]) for target, view in zip(data.views, nearest, strict=True)]


def effects_of(is_on):
    """Numbers of each photo and of all, which stay where they are: their gradients are in the moments of Adam."""
    rate = optax.constant_schedule(0.0)
    effects = {
        "exposure": exposure.make_effect(np.full((4, 3), 0.1), rate),
        "transients": transients.make_effect(rate),
    }
    return effects if is_on else {}


def start(rule):
    """A state of its own: a step takes its buffers."""
    state = initial_state(
        cloud(ALIVE, capacity=ROWS, seed=1), RECORDER, DENSIFICATION_RULES[rule], effects_of(CASES[rule][1])
    )
    return replace(state, step=jnp.int32(3))


def make_step(rule, **more):
    terms, is_on = CASES[rule]
    return make_train_step(
        RECORDER,
        terms,
        **{"capacity": PAIRS, **more},
        background=BACKGROUNDS["random"],
        sh_every=2,
        rule=DENSIFICATION_RULES[rule],
        depth_mode="front",
        effects=effects_of(is_on),
        extent=EXTENT,
        dropout=0.1,
    )


def summary(state, metrics):
    """What is compared: figures, gradients to Gaussians and effects' numbers (first moments), statistics."""
    moments = None if state.effects is None else {name: each[0].mu for name, each in state.effects.moments.items()}
    values = {"loss": metrics.loss, "psnr": metrics.psnr, **metrics.terms}
    return jax.tree.map(np.array, (values, (state.opt_state, moments), state.statistics))


@cache
def one_by_one(rule):
    """Means over the four views, and the statistics after all of them."""
    step, statistics, summaries = make_step(rule), start(rule).statistics, []
    for target in views():
        state, metrics = step(replace(start(rule), statistics=statistics), target, KEY)
        statistics = jax.tree.map(jnp.array, state.statistics)
        summaries.append(summary(state, metrics)[:2])
    values, gradients = jax.tree.map(lambda *each: np.mean(np.stack(each).astype(np.float64), 0), *summaries)
    return SimpleNamespace(values=values, gradients=gradients, statistics=jax.tree.map(np.array, statistics))


@cache
def together(rule, num_devices, **more):
    mesh = device_mesh(num_devices, 4)
    step = make_step(rule, mesh=mesh, **more)
    return step(data_parallel.replicate(start(rule), mesh), data_parallel.stack_views(views(), mesh), KEY)


@pytest.mark.parametrize(
    ("rule", "num_devices"), [("error", 2), *(pytest.param("adc", count, marks=pytest.mark.long) for count in (1, 2))]
)
def test_a_step_over_four_views_is_the_mean_of_one_device_over_them(rule, num_devices):
    expected = one_by_one(rule)
    state, metrics = together(rule, num_devices)
    assert not metrics.overflowed and metrics.finite
    assert int(state.step) == 4
    values, gradients, statistics = summary(state, metrics)
    assert_close(values, expected.values)
    assert_close(gradients, expected.gradients, kind="gradient")
    assert_close(statistics, expected.statistics, kind="gradient")
    assert np.any(statistics.views) and np.any(gradients[0].sh_rest) and np.any(gradients[0].means)
    if CASES[rule][1]:
        assert all(np.any(leaf) for leaf in jax.tree.leaves(gradients[1]))


def test_a_step_that_overflows_leaves_every_bit_and_reports_what_it_needs():
    _, enough = together("error", 2)
    state, metrics = together("adc", 2, capacity=64)
    assert metrics.overflowed and int(metrics.needed) == int(enough.needed) > 64
    jax.tree.map(np.testing.assert_array_equal, jax.device_get(state), jax.device_get(start("adc")))


def test_steps_take_the_views_that_one_device_would_take_one_by_one():
    data, mesh = data_set(), device_mesh(2, 4)
    target = several_views(data, 7, 0.5, mesh=mesh, views_per_step=4)(1)
    order = [view_order(7, place, 4) for place in range(4, 8)]
    beside = [draw_neighbor(data.neighbors[view], 7, place) for view, place in zip(order, range(4, 8), strict=True)]
    np.testing.assert_array_equal(target.photo, order)
    np.testing.assert_array_equal(target.neighbor.photo, beside)
    assert {shard.data.shape[0] for shard in target.image.addressable_shards} == {2}


def test_views_that_are_no_multiple_of_the_devices_are_one_line():
    with pytest.raises(InputError, match="views_per_step=3: is no multiple of 2 devices"):
        device_mesh(2, 3)


SETTINGS = Settings(
    seed=3,
    model=Model(background="random", max_gaussians=ROWS),
    schedule=Schedule(
        views_per_step=2,
        phases=(Phase("coarse", 12, Weights(dssim=0.0), image_scale=2, density_control=True, cull_below=0.01),),
        sh_every=4,
    ),
    density=Density(start=1, stop=12, every=4, reset_every=10),
)


def test_a_run_on_two_devices_is_that_of_one_with_as_many_views_a_step_and_goes_on_with_one():
    frames = photographed(cloud(50, seed=5), CAMERAS[:3], with_mattes=True)
    optimizer = make_optimizer(Rates(), 1.0, 6)

    def fitted(num_devices, state=None):
        mesh, states = device_mesh(num_devices, 2), []
        state = (
            initial_state(cloud(30, capacity=ROWS, seed=1), optimizer, DENSIFICATION_RULES["adc"])
            if state is None
            else state
        )
        work = Work(
            plan(SETTINGS),
            frames,
            1.0,
            optimizer,
            observe=lambda progress: states.append(jax.device_get(progress.state)),
            mesh=mesh,
        )
        return jax.device_get(follow(work, data_parallel.replicate(state, mesh))), states

    (one, _), (two, states) = fitted(1), fitted(2)
    assert int(count_alive(states[3].gaussians)) > 30
    assert_close(two.gaussians, one.gaussians, **ROUNDED)
    resumed, _ = fitted(1, states[3])
    assert_close(resumed.gaussians, one.gaussians, **ROUNDED)
