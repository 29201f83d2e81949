from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, cloud, photographed
from tolerances import assert_close

import rasterizer
from gsjax import rendering
from gsjax.gaussians import opacities
from gsjax.metrics.images import psnr
from gsjax.scene import batches
from gsjax.settings import Density, Rates, Weights
from gsjax.training.capacity import largest_need
from gsjax.training.densification import gradient_driven
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.initialize import DEAD_LOGIT
from gsjax.training.optimizers import make_optimizer, zero_moments
from gsjax.training.state import count_alive, cull, densify, initial_state, reset_opacities
from gsjax.training.step import BACKGROUNDS, in_photo, make_train_step
from gsjax.training.terms import TERMS, weigh_terms

ALIVE, CAPACITY, PAIRS = 180, 200, 8192
SIZE = (32, 32)
CAMERAS = [camera_at(eye, (0.0, 0.0, 4.0), size=SIZE) for eye in ((0.0, 0.0, 0.0), (1.0, 0.0, 0.3), (0.0, -1.0, 0.0))]
KEY = jax.random.key(0)
SH_EVERY = 2
FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh_dc", "sh_rest")


OPTIMIZER = make_optimizer(Rates(means=2e-3), 1.0, 200)
PHOTOS = weigh_terms(Weights(alpha=0.1))


def step_with(terms=PHOTOS, **changes):
    """The compiled step of a vanilla phase over random colours, but for what is changed."""
    how = {"capacity": PAIRS, "background": BACKGROUNDS["random"], "rule": DENSIFICATION_RULES["adc"]}
    return make_train_step(OPTIMIZER, terms, sh_every=SH_EVERY, **how | changes)


@pytest.fixture(scope="module")
def setup():
    """Photos with mattes of one cloud, and the usual step."""
    data = batches.read_batches(photographed(cloud(200, seed=5), CAMERAS, with_mattes=True))
    return SimpleNamespace(step=step_with(), data=data)


def start():
    return initial_state(cloud(ALIVE, capacity=CAPACITY, seed=1), OPTIMIZER)


def run(setup, state, steps):
    """State and metrics after steps over the views in turn."""
    metrics = []
    for index in range(steps):
        state, reported = setup.step(state, setup.data.views[index % len(CAMERAS)], KEY)
        metrics.append(reported)
    return state, metrics


def copied(tree):
    return jax.tree.map(jnp.copy, tree)


def assert_identical(actual, expected):
    jax.tree.map(np.testing.assert_array_equal, actual, expected)


def moments_of_both(before, after):
    """(field, moment before, moment after) of all moments of the optimizer."""
    leaves = [jax.tree.flatten_with_path(state.opt_state)[0] for state in (before, after)]
    for (path, old), (_, new) in zip(*leaves, strict=True):
        field = jax.tree_util.keystr(path).rpartition(".")[2]
        if field in FIELDS:
            yield field, np.asarray(old), np.asarray(new)


@contextmanager
def nothing_traced():
    """In here no program may be traced that renders, as every step does."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(rendering, "render", None)
        yield


def test_one_compilation_serves_all_views_steps_and_bands_whatever_happens_to_the_state(setup):
    state = start()
    kinds = jax.tree.map(lambda x: (x.shape, x.dtype, x.weak_type), state)
    state, _ = run(setup, state, 1)
    how = {"optimizer": OPTIMIZER, "budget": CAPACITY, "rule": DENSIFICATION_RULES["adc"]}
    for change in (
        partial(reset_opacities, limit=0.01),
        partial(cull, optimizer=OPTIMIZER, min_opacity=0.001),
        lambda state: densify(state, KEY, jnp.float32(2.0), jnp.asarray(False), density=Density(), **how),
    ):
        before, state = state, change(state)
        assert before.gaussians.means.is_deleted(), "it takes the arrays of the state before"
        assert jax.tree.map(lambda x: (x.shape, x.dtype, x.weak_type), state) == kinds
    with nothing_traced():
        state, metrics = run(setup, state, 7)
        with pytest.raises(TypeError, match="not callable"):
            step_with(capacity=PAIRS + 1)(start(), setup.data.views[0], KEY)
    assert int(state.step) == 8
    assert not any(bool(m.overflowed) for m in metrics)
    assert jax.tree.map(lambda x: (x.shape, x.dtype, x.weak_type), state) == kinds


def test_the_report_is_of_the_view_before_the_update(setup):
    before = replace(start(), step=jnp.int32(1))
    gaussians = copied(before.gaussians)
    color = BACKGROUNDS["random"](jax.random.fold_in(KEY, 1))  # Each step has a colour of its own.
    _, metrics = setup.step(before, setup.data.views[1], KEY)
    batch = batches.decode(setup.data.views[1], color)
    view = jax.jit(rendering.render, static_argnames="capacity")(
        gaussians, batch.camera, capacity=PAIRS, background=color, active_degree=0
    )
    assert_close(metrics.psnr, psnr(jnp.clip(view.colors, 0, 1), batch.image), rtol=1e-4, atol=0, why="sums differ")
    assert int(metrics.needed) == int(view.splats.pairs.needed)
    assert set(metrics.terms) == {"l1", "dssim", "alpha"}
    assert_close(metrics.terms["l1"], jnp.mean(jnp.abs(view.colors - batch.image)))
    assert_close(metrics.loss, 0.8 * metrics.terms["l1"] + 0.2 * metrics.terms["dssim"] + 0.1 * metrics.terms["alpha"])


def test_an_overflowing_step_leaves_every_bit_and_says_what_it_needs(setup):
    state, _ = run(setup, start(), 2)
    before = copied(state)
    after, metrics = step_with(capacity=64)(state, setup.data.views[2], KEY)
    assert bool(metrics.overflowed)
    assert_identical(after, before)
    camera = CAMERAS[2]
    assert int(metrics.needed) == int(jax.jit(rendering.needed_capacity)(before.gaussians, camera)) > 64


def test_living_rows_move_and_gather_statistics_and_dead_rows_stay_as_they_are(setup):
    before = start().gaussians
    state, _ = run(setup, start(), 3)
    for field in FIELDS:
        old, new = np.asarray(getattr(before, field)), np.asarray(getattr(state.gaussians, field))
        np.testing.assert_array_equal(new[ALIVE:], old[ALIVE:])
        assert np.abs(new[:ALIVE] - old[:ALIVE]).max() > 0
    assert int(count_alive(state.gaussians)) == ALIVE
    statistics = jax.tree.map(np.asarray, state.statistics)
    assert set(np.unique(statistics.views)) <= {0, 1, 2, 3} and (statistics.views[:ALIVE] == 3).mean() > 0.5
    assert not statistics.views[ALIVE:].any() and statistics.gradient.max() > 0
    assert np.all((statistics.gradient > 0) <= (statistics.views > 0))


def test_what_shows_in_the_padding_alone_is_not_seen_in_the_photo():
    """A photo of 30x20 in a set whose largest is 50x40: splats of half width 4 and half height 2."""
    means = np.array([[10.0, 10.0], [33.9, 10.0], [34.1, 10.0], [10.0, 21.9], [10.0, 22.1], [40.0, 30.0], [10.0, 10.0]])
    projection = rasterizer.Projection(
        means2d=jnp.asarray(means[None], jnp.float32),
        depths=jnp.ones((1, 7), jnp.float32),
        conics=jnp.ones((1, 7, 3), jnp.float32),
        extents=jnp.tile(jnp.array([4.0, 2.0], jnp.float32), (1, 7, 1)),
        visible=jnp.arange(7)[None] < 6,
    )
    is_seen = in_photo(projection, jnp.array([30, 20], jnp.int32))
    np.testing.assert_array_equal(is_seen, [True, True, False, True, False, False, False])


def test_densification_moves_moments_with_their_gaussians(setup, monkeypatch):
    monkeypatch.setattr(gradient_driven, "DENSE_SHARE", 0.25)
    monkeypatch.setattr(gradient_driven, "MIN_OPACITY", 0.0)
    state, _ = run(setup, start(), 3)
    mean_gradient = np.asarray(state.statistics.gradient / jnp.maximum(state.statistics.views, 1))
    # Room for 20: 30 reach the threshold; those under 0.1 units are cloned, the others split.
    monkeypatch.setattr(gradient_driven, "GRADIENT", float(np.sort(mean_gradient)[-30]))
    density = Density(every=7)  # of no other test, so that a program with these thresholds is compiled
    before = jax.tree.map(np.array, state)
    densified = jax.jit(partial(gradient_driven.densify, density=density, extent=1.0, prune_large=False))
    expected, moved = densified(state.gaussians, state.statistics, jax.random.fold_in(KEY, state.step))
    source, fresh = np.asarray(moved.source), np.asarray(moved.fresh)
    how = {"optimizer": OPTIMIZER, "density": density, "budget": CAPACITY, "rule": DENSIFICATION_RULES["adc"]}
    after = densify(state, KEY, jnp.float32(1.0), jnp.asarray(False), **how)
    assert_close(after.gaussians, expected)
    assert int(count_alive(after.gaussians)) == CAPACITY
    assert set(source[ALIVE:]) == set(np.argsort(mean_gradient)[-20:])
    assert 0 < fresh[:ALIVE].sum() < 20  # those split; a cloned original goes on
    for _, old, new in moments_of_both(before, after):
        np.testing.assert_array_equal(new[~fresh], old[source[~fresh]])
        assert not new[fresh].any()
    assert not np.any(after.statistics.views) and not np.any(after.statistics.gradient)
    assert int(after.step) == 3


def test_a_reset_forgets_the_moments_of_opacities_only(setup):
    state, _ = run(setup, start(), 3)
    before = jax.tree.map(np.array, state)
    after = reset_opacities(state, limit=0.01)
    assert_close(opacities(after.gaussians), np.minimum(opacities(before.gaussians), np.float32(0.01)))
    assert int(count_alive(after.gaussians)) == ALIVE
    for field, old, new in moments_of_both(before, after):
        assert old.any()
        np.testing.assert_array_equal(new, np.zeros_like(old) if field == "logit_opacities" else old)
    integers = [[int(x) for x in jax.tree.leaves(s.opt_state) if x.dtype == np.int32] for s in (before, after)]
    assert integers[0] == integers[1] and set(integers[0]) == {3}
    with pytest.raises(ValueError, match="field 'colors' is none of log_scales, logit_opacities, means, quats, sh_dc,"):
        zero_moments(state, "colors")


def test_a_cull_kills_the_faint_and_leaves_the_others(setup):
    state, _ = run(setup, start(), 3)
    before = jax.tree.map(np.array, state)
    faint = np.asarray(opacities(before.gaussians)) < 0.5
    after = cull(state, optimizer=OPTIMIZER, min_opacity=0.5)
    assert 20 < faint[:ALIVE].sum() < ALIVE - 20
    assert int(count_alive(after.gaussians)) == (~faint).sum()
    assert_close(after.gaussians.logit_opacities[faint], np.full(faint.sum(), DEAD_LOGIT))
    for field in FIELDS:
        np.testing.assert_array_equal(
            np.asarray(getattr(after.gaussians, field))[~faint], getattr(before.gaussians, field)[~faint]
        )
    for _, old, new in moments_of_both(before, after):
        np.testing.assert_array_equal(new, np.where(faint.reshape(-1, *[1] * (old.ndim - 1)), 0, old))


@pytest.mark.long  # `several_devices/test_views_of_a_step.py` has a shorter step with a neighbour.
def test_a_surface_phase_is_one_program_too_and_every_term_is_finite(setup):
    normals = np.zeros((*SIZE[::-1], 3), np.int8)
    normals[..., 2] = -batches.NORMAL_UNIT
    normals[0, 0] = 0  # a hole
    measured = np.full(SIZE[::-1], 2, np.float32), np.full(SIZE[::-1], 255, np.uint8)
    data = batches.with_depths(batches.with_normals(setup.data, [normals] * 3), [measured] * 3)
    data = batches.with_skies(data, [np.ones(SIZE[::-1], bool)] * 3)
    terms = weigh_terms(dict.fromkeys(TERMS.keys() - {"normal_consistency"}, 0.1))
    capacity = int(1.1 * largest_need(start().gaussians, data))
    step = step_with(terms, capacity=capacity, background=BACKGROUNDS["white"], rule=None)
    state = start()
    for index in range(2):
        with nothing_traced() if index else nullcontext():
            state, metrics = step(state, replace(data.views[index], neighbor=data.views[index + 1]), KEY)
        assert set(metrics.terms) == {each.name for each in terms}
        assert all(0 < float(value) < 9 for value in metrics.terms.values()), metrics.terms  # one of them is in pixels
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(state))
    assert not np.any(state.statistics.views)
    # A neighbour that looks closer, and needs more room than any view.
    closer = replace(data.views[1].camera, K=data.views[1].camera.K * np.float32([[3, 1, 1], [1, 3, 1], [1, 1, 1]]))
    before = copied(state)
    after, metrics = step(state, replace(data.views[0], neighbor=replace(data.views[1], camera=closer)), KEY)
    assert metrics.overflowed and int(metrics.needed) > capacity
    assert_identical(after, before)
