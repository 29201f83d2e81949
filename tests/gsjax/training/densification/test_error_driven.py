from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import camera_at, cloud, photographed
from tolerances import assert_close

import rasterizer
from gsjax.gaussians import Gaussians, opacities, rotation_matrices, scales
from gsjax.scene import batches
from gsjax.scene.cameras import Camera
from gsjax.settings import Density, Rates, Weights
from gsjax.training.densification import error_driven
from gsjax.training.densification.error_driven import ErrorStatistics
from gsjax.training.densification.gradient_driven import densifies, is_alive
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.initialize import DEAD_LOGIT
from gsjax.training.optimizers import make_optimizer
from gsjax.training.state import initial_state
from gsjax.training.step import BACKGROUNDS, make_train_step
from gsjax.training.terms import weigh_terms

KEY = jax.random.key(0)
ROWS, ALIVE = 40, 20
DENSITY = Density(rule="error", replace=0.1)
MAX_SHARE = 0.5


@pytest.fixture(autouse=True)
def _thresholds(monkeypatch):
    monkeypatch.setattr(error_driven, "MIN_OPACITY", 0.1)
    monkeypatch.setattr(error_driven, "MAX_SHARE", MAX_SHARE)


EXTENT = 10.0


def scene(alive=ALIVE, *, opacity=None) -> Gaussians:
    """So many Gaussians of opacity 0.6 in 40 rows; `opacity`: row -> another."""
    odds = np.where(np.arange(ROWS) < alive, np.log(0.6 / 0.4), DEAD_LOGIT)
    for row, value in (opacity or {}).items():
        odds[row] = np.log(value / (1 - value))
    return replace(cloud(alive, capacity=ROWS), logit_opacities=jnp.asarray(odds, jnp.float32))


def statistics(error, weight, views=3.0, depths=0.0) -> ErrorStatistics:
    return ErrorStatistics(
        *(jnp.asarray(np.broadcast_to(np.asarray(x, np.float32), ROWS)) for x in (error, weight, views, depths))
    )


@jax.jit
def densified(gaussians, sums, count=ROWS, prune_large=False):
    return error_driven.densify(
        gaussians, sums, KEY, density=DENSITY, extent=EXTENT, prune_large=prune_large, count=jnp.int32(count)
    )


def rows_of(tree, index):
    return jax.tree.map(lambda x: np.asarray(x)[index], tree)


def alive(gaussians):
    return np.asarray(is_alive(gaussians))


RISING = np.arange(ROWS, dtype=np.float32)


# --- a split


@pytest.mark.parametrize("opacity", [1e-4, 0.6, 0.99999])
def test_both_halves_show_the_same_line_integral_mean_and_spread_as_the_whole(opacity, x64):
    logit = np.log(opacity) - np.log1p(-opacity)
    fields = [1.0, -2.0, 0.5], [0.9, 0.2, -0.3, 0.4], np.log([0.2, 0.7, 0.1]), logit, np.zeros((1, 3)), np.zeros((0, 3))
    whole = Gaussians(*(jnp.asarray(np.array(field))[None] for field in fields))
    halves = [error_driven.split_half(whole, jnp.array([side])) for side in (-1.0, 1.0)]
    axes = np.asarray(rotation_matrices(whole.quats)[0])
    places = np.stack([(np.asarray(half.means)[0] - np.asarray(whole.means)[0]) @ axes for half in halves])
    np.testing.assert_allclose(places.sum(0), 0, atol=1e-12)
    np.testing.assert_allclose(places[:, [0, 2]], 0, atol=1e-12)
    sizes = np.asarray(scales(halves[0]))[0]
    np.testing.assert_allclose(sizes**2 + places[0] ** 2, np.asarray(scales(whole))[0] ** 2, rtol=1e-9)
    assert np.asarray(scales(halves[1]))[0].tolist() == sizes.tolist()

    x = np.linspace(-8, 8, 200_001)

    def alpha(gaussians, place):
        return float(opacities(gaussians)[0]) * np.exp(-0.5 * ((x - place) / float(scales(gaussians)[0, 1])) ** 2)

    lit = 1 - (1 - alpha(halves[0], places[0, 1])) * (1 - alpha(halves[1], places[1, 1]))
    np.testing.assert_allclose(np.trapezoid(lit, x), np.trapezoid(alpha(whole, 0.0), x), rtol=1e-9)


# --- a densification


def test_the_count_is_reached_and_the_largest_errors_split():
    before = scene()
    weight = np.where(RISING == 0, 9.0, RISING)  # Rows 1 to 3 are seen least.
    after, moved = densified(before, statistics(RISING, weight), 30)
    assert alive(after).sum() == 30
    parents, free = np.arange(7, 20), np.array([1, 2, 3, *range(20, 30)])
    # Ten more and a tenth of them all that moves: the worst takes the first free row.
    np.testing.assert_array_equal(np.asarray(moved.source)[free], parents[::-1])
    np.testing.assert_array_equal(np.flatnonzero(np.asarray(moved.source) != np.arange(ROWS)), free)
    rows = [0, 4, 5, 6]
    np.testing.assert_array_equal(np.flatnonzero(~np.asarray(moved.fresh)), rows)
    for field in ("means", "quats", "log_scales", "logit_opacities", "sh_dc", "sh_rest"):
        np.testing.assert_array_equal(np.asarray(getattr(after, field))[rows], np.asarray(getattr(before, field))[rows])
    for side, index in ((-1.0, parents), (1.0, free[::-1])):
        expected = error_driven.split_half(rows_of(before, parents), jnp.full(13, side))
        assert_close(rows_of(after, index), rows_of(expected, slice(None)))


def test_a_full_budget_moves_from_the_least_seen_to_the_worst():
    before = scene(ROWS)
    weight = 100 - RISING  # Seen least: the last rows, were they not also those that split.
    weight[:6] = [3, 2, 1, 0, 4, 5]
    view_counts = np.full(ROWS, 2.0)
    view_counts[2] = 0  # in none of the views since
    after, moved = densified(before, statistics(RISING, weight, view_counts))
    assert alive(after).all()
    np.testing.assert_array_equal(np.flatnonzero(np.asarray(moved.source) != np.arange(ROWS)), [0, 1, 3, 4])
    np.testing.assert_array_equal(np.asarray(moved.source)[[0, 1, 3, 4]], [39, 38, 37, 36])
    np.testing.assert_array_equal(np.flatnonzero(moved.fresh), [0, 1, 3, 4, 36, 37, 38, 39])


def test_the_faint_go_first_and_their_rows_are_filled_within_the_budget():
    faint = {0: 0.05, 7: 0.09, 39: 0.02}
    after, moved = densified(scene(ROWS, opacity=faint), statistics(RISING, RISING + 1))
    # Three rows of the faint and four of the least seen (of the rest: rows 1 to 4) go to the seven worst.
    assert alive(after).all()
    np.testing.assert_array_equal(np.asarray(moved.source)[[0, 1, 2, 3, 4, 7, 39]], [38, 37, 36, 35, 34, 33, 32])


def test_what_is_far_away_may_be_larger_by_the_square_of_its_depth():
    large = scene()
    four_times = 4 * MAX_SHARE * EXTENT
    large = replace(large, log_scales=large.log_scales.at[4:8, 1].set(np.log(four_times)))
    depths = 3.0 * np.where(RISING == 4, 1.9, np.where(RISING == 5, 2.1, np.where(RISING == 6, 0.5, 0.0)))
    views = np.where(RISING == 7, 0.0, 3.0)
    sums = statistics(0.0, 1.0, views, depths)
    assert alive(densified(large, sums)[0])[4:8].all(), "size prunes only when asked to"
    after = densified(large, sums, ROWS, True)[0]
    assert alive(after)[4:8].tolist() == [False, True, False, False]  # the last was in no view


@pytest.mark.parametrize("count", [0, 1, ROWS])
@pytest.mark.parametrize("error", [5.0, np.nan])
def test_hard_cases_stay_finite_and_within_the_budget(count, error):
    ends = {0: 1 - 1e-7, 1: 0.1001} if count > 1 else {}
    before = scene(count, opacity=ends)
    after, moved = densified(before, statistics(error, 0.0))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(jax.tree.map(np.asarray, after)))
    expected = {0: 0, 1: 1 + (error > 0), ROWS: ROWS}[count]
    assert alive(after).sum() == expected
    assert np.all(np.asarray(moved.fresh)[~alive(after)])
    if not error > 0:
        jax.tree.map(np.testing.assert_array_equal, rows_of(after, alive(before)), rows_of(before, alive(before)))


def counts(density, start, budget, died=0):
    """Of Gaussians after every densification of 100 steps."""
    history, count = [], start
    for step in range(1, 101):
        if densifies(density, step):
            rows = cloud(count - died, capacity=ROWS)
            count = int(error_driven.wanted_count(rows, None, density, step=jnp.int32(step), budget=budget))
            history.append(count)
    return history


def test_the_budget_is_full_on_time_by_equal_factors():
    density = Density(rule="error", start=20, stop=90, every=10, full_by=0.6)
    assert counts(density, 5, 40) == [9, 15, 25, 40, 40, 40]  # at 30, 40, ..., 80; 20 + 0.6 * 70 = 62
    assert counts(replace(density, full_by=0.0), 5, 40) == [40] * 6
    assert counts(density, 40, 40) == [40] * 6
    assert counts(density, 5, 40, died=2)[3:] == [40] * 3


# --- what is seen

EXTENT = 4.2  # Of the cameras: half of the cloud is nearer.


@pytest.fixture(scope="module")
def setup():
    optimizer = make_optimizer(Rates(), 1.0, 60)
    cameras = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0)) for x in (-0.6, 0.6)]
    data = batches.read_batches(photographed(cloud(50, seed=5), cameras))

    def step(rule):
        how = {"capacity": 4096, "background": BACKGROUNDS["black"], "sh_every": 10, "extent": EXTENT}
        return make_train_step(optimizer, weigh_terms(Weights(alpha=0.0)), rule=rule, **how)

    def start():
        return initial_state(cloud(ALIVE, capacity=ROWS, seed=1), optimizer, DENSIFICATION_RULES["error"])

    return SimpleNamespace(data=data, step=step, start=start, seeing=step(DENSIFICATION_RULES["error"]))


def dense_weights(gaussians: Gaussians, camera: Camera):
    """`[H, W, 3 + N]` the picture (degree 0) and every Gaussian's blending weight at every pixel, in float64."""
    wide, viewmat, K = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), (gaussians, camera.viewmat, camera.K))
    colors = jnp.maximum(0.28209479177387814 * wide.sh_dc[:, 0] + 0.5, 0)
    channels = jnp.concatenate([colors, jnp.eye(wide.num_gaussians)], -1)
    shape = wide.means, wide.quats, scales(wide), opacities(wide)
    size = camera.width, camera.height
    return rasterizer.rasterization(*shape, channels, viewmat[None], K[None], *size, backend="reference")[0][0]


def test_the_error_and_the_weight_of_a_gaussian_are_sums_over_the_pixels(setup):
    target = setup.data.views[0]
    # A photo of 24x20 in a set of 32x24: what is beside it counts for nothing.
    target = replace(target, size=np.array([24, 20], np.int32))
    state, _ = setup.seeing(setup.start(), target, KEY)
    with jax.enable_x64(True):
        batch = batches.decode(target, jnp.zeros(3, jnp.float32))
        rendered = jax.jit(dense_weights)(setup.start().gaussians, batch.camera)
        rendered, inside = np.asarray(rendered), np.asarray(batch.valid)
        error = np.abs(rendered[..., :3] - np.asarray(batch.image, np.float64)).mean(-1)[inside]
        weights = rendered[..., 3:][inside]
    viewmat = np.asarray(batch.camera.viewmat)
    depths = np.asarray(setup.start().gaussians.means) @ viewmat[2, :3] + viewmat[2, 3]
    assert 0.3 < np.mean(depths[:ALIVE] < EXTENT) < 0.7
    weights = weights * np.minimum(depths / EXTENT, 1) ** 2
    assert inside.sum() == 24 * 20
    assert_close(state.statistics.weight, weights.sum(0), rtol=1e-4, atol=1e-4, why="sums of 480 pixels")
    assert_close(state.statistics.error, weights.T @ error, rtol=1e-4, atol=1e-4, why="sums of 480 pixels")
    is_visible = np.asarray(state.statistics.views) > 0
    assert_close(
        state.statistics.depths[:ALIVE], (np.where(is_visible[:ALIVE], depths[:ALIVE], 0) / EXTENT), kind="value"
    )


def test_watching_changes_nothing_else(setup):
    target = setup.data.views[0]
    watched, reported = setup.seeing(setup.start(), target, KEY)
    unwatched, expected = setup.step(None)(setup.start(), target, KEY)
    assert float(reported.loss) == pytest.approx(float(expected.loss), rel=1e-6)
    assert_close(watched.gaussians.means, unwatched.gaussians.means)
    assert_close(watched.gaussians.logit_opacities, unwatched.gaussians.logit_opacities)
    assert not np.any(unwatched.statistics.error)
    sums = jax.tree.map(np.asarray, watched.statistics)
    assert not any(x[ALIVE:].any() for x in (sums.error, sums.weight, sums.views)), "dead rows have no part"
