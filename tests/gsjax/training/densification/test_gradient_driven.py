import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import cloud
from tolerances import assert_close

from gsjax.gaussians import Gaussians, opacities, rotation_matrices, scales
from gsjax.settings import Density
from gsjax.training.densification import gradient_driven as control
from gsjax.training.densification.gradient_driven import GradientStatistics
from gsjax.training.initialize import DEAD_LOGIT

EXTENT = 10.0


@pytest.fixture(autouse=True)
def _thresholds(monkeypatch):
    """Small is up to 0.1, large over 5."""
    monkeypatch.setattr(control, "GRADIENT", 0.5)
    monkeypatch.setattr(control, "MIN_OPACITY", 0.1)
    monkeypatch.setattr(control, "MAX_SHARE", 0.5)


CAPACITY, ALIVE = 16, 10
KEY = jax.random.key(3)


def scene(*, opacity=None, size=None) -> Gaussians:
    """10 Gaussians in 16 rows, of scale 0.05 and opacity 0.6 where nothing else is said (row -> value)."""
    logits = np.where(np.arange(CAPACITY) < ALIVE, np.log(0.6 / 0.4), DEAD_LOGIT)
    log_scales = np.full((CAPACITY, 3), np.log(0.05))
    for row, value in (opacity or {}).items():
        logits[row] = np.log(value / (1 - value))
    for row, value in (size or {}).items():
        log_scales[row, row % 3] = np.log(value)
    fields = {"logit_opacities": jnp.asarray(logits, jnp.float32), "log_scales": jnp.asarray(log_scales, jnp.float32)}
    return Gaussians(**{**cloud(ALIVE, capacity=CAPACITY).__dict__, **fields})


def gradients(mean_of, views=4):
    """Statistics over some views whose mean gradient is `mean_of[row]`, else 0."""
    sums = np.zeros(CAPACITY, np.float32)
    sums[list(mean_of)] = np.array(list(mean_of.values())) * views
    return GradientStatistics(jnp.asarray(sums), jnp.full(CAPACITY, views, jnp.float32))


@jax.jit
def densified(gaussians, statistics, prune_large=False, key=KEY):
    return control.densify(gaussians, statistics, key, density=Density(), extent=EXTENT, prune_large=prune_large)


def alive(gaussians):
    return np.asarray(control.is_alive(gaussians))


def rows(tree, index):
    return jax.tree.map(lambda x: np.asarray(x)[index], tree)


def assert_same_rows(actual, expected, index):
    jax.tree.map(np.testing.assert_array_equal, rows(actual, index), rows(expected, index))


def test_a_small_gaussian_is_cloned_and_the_original_keeps_its_state():
    before = scene()
    after, moved = densified(before, gradients({4: 0.5, 7: 0.4999}))  # The threshold is 0.5.
    assert alive(after).sum() == ALIVE + 1
    assert_same_rows(after, before, slice(ALIVE))
    new = ALIVE  # the first free row
    assert int(moved.source[new]) == 4
    assert_same_rows(rows(after, [new]), rows(before, [4]), slice(None))
    assert bool(moved.fresh[new]) and not np.any(moved.fresh[:ALIVE])


def test_a_large_gaussian_is_split_in_two_smaller_ones_inside_itself():
    before = scene(size={3: 0.4})
    after, moved = densified(before, gradients({3: 2.0}))
    halves = [3, ALIVE]
    assert alive(after).sum() == ALIVE + 1
    assert np.all(moved.fresh[np.array(halves)])
    assert_close(scales(after)[np.array(halves)], np.tile(np.asarray(scales(before))[3] / 1.6, (2, 1)))
    for name in ("quats", "logit_opacities", "sh_dc", "sh_rest"):
        field = np.asarray(getattr(after, name))[halves]
        np.testing.assert_array_equal(field, np.repeat(np.asarray(getattr(before, name))[3:4], 2, axis=0))
    assert np.abs(np.subtract(*np.asarray(after.means)[halves])).max() > 1e-3
    assert_same_rows(after, before, [0, 1, 2, 4, 5, 6, 7, 8, 9])


def test_split_positions_are_samples_of_the_gaussian():
    before = scene(size={3: 0.4})
    after = jax.vmap(lambda key: densified(before, gradients({3: 2.0}), key=key)[0])(jax.random.split(KEY, 2000))
    local = (after.means[:, np.array([3, ALIVE])] - before.means[None, None, 3]) @ rotation_matrices(before.quats)[3]
    samples = np.asarray(local, np.float64).reshape(-1, 3)
    expected = np.asarray(scales(before))[3]
    np.testing.assert_allclose(samples.std(0), expected, rtol=0.06)  # 4,000 samples: 1.1 % a standard error
    np.testing.assert_allclose(samples.mean(0), np.zeros(3), atol=0.08 * expected.max())


def test_when_rows_are_short_the_largest_gradients_win():
    means = {row: 1 + 0.1 * ((7 * row) % 10) for row in range(ALIVE)}
    after, moved = densified(scene(), gradients(means))
    assert alive(after).all()
    winners = sorted(means, key=means.get)[-(CAPACITY - ALIVE) :]
    assert sorted(np.asarray(moved.source)[ALIVE:]) == sorted(winners)
    np.testing.assert_array_equal(np.asarray(moved.source)[:ALIVE], np.arange(ALIVE))


def test_faint_gaussians_die_and_their_rows_serve_at_once():
    before = scene(opacity={0: 0.09, 5: 0.11, 6: 0.02})
    after, moved = densified(before, gradients({}, views=0))  # None was in any view.
    assert_same_rows(after, before, [1, 2, 3, 4, 5, 7, 8, 9])
    np.testing.assert_array_equal(np.flatnonzero(~alive(after)), [0, 6, *range(ALIVE, CAPACITY)])
    assert np.all(moved.fresh[np.array([0, 6])]) and not bool(moved.fresh[5])
    # A dying one does not grow, and its row is the first that is given away.
    after, moved = densified(before, gradients({0: 9.0, 3: 1.0}))
    assert int(moved.source[0]) == 3 and alive(after)[0] and alive(after).sum() == ALIVE - 1


def test_a_large_gaussian_that_finds_no_row_for_its_second_half_waits():
    full = scene(opacity=dict.fromkeys(range(CAPACITY), 0.9), size={3: 7.0})
    steeper = {row: 9.0 for row in range(CAPACITY) if row != 3}
    after, moved = densified(full, gradients({**steeper, 3: 1.0}), prune_large=True)
    assert_same_rows(after, full, slice(None))
    room = scene(opacity=dict.fromkeys(range(CAPACITY), 0.9) | {8: 0.01}, size={3: 7.0})
    after, moved = densified(room, gradients({3: 1.0}), prune_large=True)
    assert int(moved.source[8]) == 3 and alive(after).all()


def densify_and_prune_of_3dgs(gaussians, gradient, prune_large):
    """Sizes and opacities of what is left, sorted, by the order of 3DGS: clone, split, then prune (numpy)."""
    sizes, alphas = np.asarray(scales(gaussians).max(1)), np.asarray(opacities(gaussians))
    rows = [(sizes[k], alphas[k], gradient.get(k, 0.0)) for k in np.flatnonzero(alive(gaussians))]
    rows += [(size, opacity, 0.0) for size, opacity, slope in rows if slope >= 0.5 and size <= 0.1]
    halves = [(size / 1.6, opacity, 0.0) for size, opacity, slope in rows if slope >= 0.5 and size > 0.1] * 2
    rows = [row for row in rows if not (row[2] >= 0.5 and row[0] > 0.1)] + halves
    return sorted((size, opacity) for size, opacity, _ in rows if opacity >= 0.1 and not (prune_large and size > 5))


@pytest.mark.parametrize("prune_large", [False, True])
def test_with_room_enough_what_is_left_is_what_3dgs_leaves(prune_large):
    sizes = {0: 0.1001, 1: 6.0, 2: 7.5, 3: 9.0, 4: 5.5, 5: 0.0999, 6: 0.2}
    gradient = {0: 1.0, 1: 0.7, 3: 2.0, 5: 0.9, 6: 3.0, 7: 0.4, 8: 5.0}
    before = scene(opacity={6: 0.05, 8: 0.02, 9: 0.3}, size=sizes)
    after, _ = densified(before, gradients(gradient), prune_large)
    sizes_and_opacities = (np.asarray(scales(after).max(1)), np.asarray(opacities(after)))
    remaining = sorted(zip(*(values[alive(after)] for values in sizes_and_opacities), strict=True))
    np.testing.assert_allclose(remaining, densify_and_prune_of_3dgs(before, gradient, prune_large), rtol=1e-5)


def test_accumulated_gradients_are_norms_in_ndc_units_of_the_visible():
    gradient = np.random.default_rng(0).normal(size=(CAPACITY, 2))
    visible = np.arange(CAPACITY) % 3 > 0
    view = jnp.asarray(gradient, jnp.float32), jnp.asarray(visible), jnp.ones(CAPACITY), jnp.array([40, 30])
    statistics = control.accumulate(control.accumulate(control.empty_statistics(CAPACITY), *view), *view)
    expected = np.where(visible, np.linalg.norm(gradient * [20, 15], axis=1), 0)
    assert_close(statistics.gradient, 2 * expected)
    assert_close(statistics.views, 2.0 * visible)


@pytest.mark.parametrize(
    ("background", "settings", "expected"),
    [
        # At 2, 4, 5, 6 and 8: what was fitted to the white goes once more, before anything grows.
        ("white", {}, ["reset", (4, False), "reset", (6, True), (8, True)]),
        ("black", {}, [(4, False), "reset", (6, True), (8, True)]),
        # Without resets, of any kind: past a fifth of the steps.
        ("white", {"reset_every": 0}, [(4, True), (6, True), (8, True)]),
    ],
)
def test_gaussians_grow_are_reset_and_pruned_by_size_when_due(background, settings, expected):
    density, calls = Density(**{"start": 2, "stop": 9, "every": 2, "reset_every": 5} | settings), []
    for step in range(1, 12):
        calls += [(step, control.prunes_large(density, step))] * control.densifies(density, step)
        calls += ["reset"] * control.resets_opacities(density, step, background)
    assert calls == expected
