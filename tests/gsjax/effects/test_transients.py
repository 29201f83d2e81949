"""Masks of what stood in one photo only: in closed form, at their bounds, and the quantile that they follow."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from scipy import ndimage
from small_scenes import camera_at
from tolerances import assert_close

from gsjax.effects import transients
from gsjax.effects.observations import block_means
from gsjax.effects.simulation import initial_state as effects_state
from gsjax.effects.simulation import mask_untrusted, update_effects
from gsjax.io.scenes import load_scene
from gsjax.rendering import View
from gsjax.settings import Density
from gsjax.targets import Batch

CAMERA = camera_at(size=(32, 24))
RATE = optax.constant_schedule(transients.RATE)
EFFECTS = {"transients": transients.make_effect(RATE)}


def batch(image, valid=None):
    valid = np.ones((24, 32), bool) if valid is None else valid
    return Batch(CAMERA, jnp.asarray(image, jnp.float32), jnp.asarray(valid), None, None, jnp.int32(0))


def view(colors):
    return View(jnp.asarray(colors, jnp.float32), jnp.ones((24, 32), jnp.float32), None, None)


def grey(value=0.5):
    return np.full((24, 32, 3), value, np.float32)


def test_a_square_is_left_out_and_single_pixels_stay():
    photo = grey()
    photo[6:14, 8:18] = 0.9
    photo[20, 3], photo[0, 0], photo[23, 31] = 0.0, 1.0, 1.0
    shown = np.asarray(transients.trusted_pixels(np.float32(np.log(0.05)), jnp.asarray(grey()), jnp.asarray(photo)))
    square = np.zeros((24, 32), bool)
    square[6:14, 8:18] = True
    # Its four corners, of whose windows it fills 9 of 25, are kept; what is beside it never goes.
    assert not shown[7:13, 9:17].any()
    assert shown[~square].all()
    assert (~shown).sum() == square.sum() - 4 * 3
    assert transients.trusted_pixels(np.float32(np.log(0.2)), jnp.asarray(grey()), jnp.asarray(photo)).all()


def test_at_the_start_everything_is_trusted():
    shown = transients.trusted_pixels(EFFECTS["transients"].initial, jnp.asarray(grey(0.0)), jnp.asarray(grey(1.0)))
    assert shown.all()


def test_the_gradient_leads_to_the_quantile_and_the_value_is_zero():
    rng = np.random.default_rng(0)
    photo = grey() + rng.uniform(0, 0.3, (24, 32, 1)).astype(np.float32)
    valid = rng.random((24, 32)) < 0.7
    off = np.abs(photo - 0.5).mean(-1)[valid]

    def added(number):
        return mask_untrusted(EFFECTS, {"transients": number}, view(grey()), batch(photo, valid))[1]

    for quantile in (0.05, 0.2, 0.29):
        value, slope = jax.value_and_grad(added)(jnp.float32(np.log(quantile)))
        above = np.mean(off > quantile)
        assert value == 0
        expected = np.float32((1 - transients.QUANTILE) * (1 - above) - transients.QUANTILE * above)
        assert_close(slope, expected, kind="value", rtol=1e-4, atol=0, why="a sum of 500 numbers")

    state = effects_state(EFFECTS)
    for _ in range(300):
        gradients = {"transients": jax.grad(added)(state.numbers["transients"])}
        state = update_effects(EFFECTS, state, gradients)
    found = np.exp(state.numbers["transients"])
    assert found == pytest.approx(np.quantile(off, transients.QUANTILE), rel=0.1)


def test_masks_of_the_user_come_first():
    photo = grey()
    photo[6:14, 8:18] = 0.9
    valid = np.ones((24, 32), bool)
    valid[:, 20:] = False
    left, _ = mask_untrusted(EFFECTS, {"transients": jnp.float32(np.log(0.05))}, view(grey()), batch(photo, valid))
    assert not left.valid[:, 20:].any()
    assert not left.valid[8:12, 10:16].any()
    assert left.valid[:5, :20].all()


@pytest.mark.parametrize("number", [-1e30, -80.0, 0.0, 80.0, 1e30])
@pytest.mark.parametrize("photo", [0.0, 1.0])
@pytest.mark.parametrize("is_valid", [True, False])
def test_hard_cases_in_value_and_gradient(number, photo, is_valid):
    """Black and saturated photos, photos without a valid pixel, renders far beyond white, a quantile at either end."""
    colors = grey(0.5)
    colors[0, 0] = [1e30, -1e30, 0.5]
    seen = batch(grey(photo), np.full((24, 32), is_valid))

    def added(number, colors):
        return mask_untrusted(EFFECTS, {"transients": number}, view(colors), seen)[1]

    value, slopes = jax.value_and_grad(added, (0, 1))(jnp.float32(number), jnp.asarray(colors))
    assert value == 0
    assert np.isfinite(slopes[0]) and not np.any(slopes[1])
    assert (slopes[0] != 0) == is_valid


def test_growth_waits_for_the_masks():
    growth = Density(start=100, stop=500)
    assert transients.delay_growth(growth, 1000) == replace(growth, start=300, stop=700)
    assert transients.delay_growth(growth, 600) == replace(growth, start=300, stop=600)
    assert transients.delay_growth(Density(start=500, stop=15000), 7000) == Density(start=3750, stop=15000)
    assert transients.delay_growth(Density(start=500, stop=400), 1000) == Density(start=500, stop=400)


def residual_maps(moved, size=(60, 80), photos=20, seed=0):
    """Noise, an edge that a short run misses everywhere, and a square in some photos."""
    rng = np.random.default_rng(seed)
    maps = []
    for index in range(photos):
        residual = np.abs(0.02 * rng.normal(size=size))
        residual[:, 30:32] += 0.3
        if index in moved:
            row, column = rng.integers(0, size[0] - 24), rng.integers(32, size[1] - 24)
            residual[row : row + 24, column : column + 24] += 0.3
        maps.append(residual)
    return maps


@pytest.mark.parametrize(("share", "is_on"), [(0.0, False), (0.05, False), (0.1, True), (0.5, True)])
def test_residuals_tell_in_how_many_photos_something_moved(share, is_on):
    found = transients.judge_residuals(residual_maps(range(round(share * 20))))
    assert found.on == is_on
    assert found.value == pytest.approx(share)


def test_the_area_far_off_is_that_of_large_regions_alone():
    residual = np.zeros((40, 50))
    residual[10:20, 10:25] = 1.0
    residual[30, :] = 1.0  # an edge: no window of five is mostly far off
    assert transients.far_off_area(residual, 0.5) == pytest.approx(150 / 2000, abs=12 / 2000)
    residual[:, 25:] = np.nan
    assert transients.far_off_area(residual, 0.5) == pytest.approx(150 / 1000, abs=12 / 1000)
    assert transients.far_off_area(np.full((40, 50), np.nan), 0.5) == 0


def test_few_photos_without_a_usable_pixel_cannot_be_judged():
    assert transients.judge_residuals([]).value is None
    assert transients.judge_residuals([np.full((8, 8), np.nan)] * 9).value is None
    assert transients.judge_residuals(residual_maps((), photos=3)).value is None


@pytest.mark.parametrize("name", ["fox", "kitchen", "fern"])
@pytest.mark.parametrize(("share", "is_on"), [(0.0, False), (0.1, True), (0.5, True)])
def test_real_photos_against_softer_ones_have_movers_where_squares_are_put(shared, name, share, is_on):
    """A render that is softer than the photo and off by some colour stands for a short run's."""
    frames = load_scene(shared / "data" / name).frames
    rng = np.random.default_rng(0)
    moved, maps = rng.permutation(len(frames))[: round(share * len(frames))], []
    for index, frame in enumerate(frames):
        stride = max(frame.width, frame.height) // 128
        photo = block_means(frame.pixels().image, stride) / 255
        shown = ndimage.gaussian_filter(photo, (1, 1, 0)) * (1 + 0.05 * rng.normal())
        if index in moved:
            side = round(0.25 * np.sqrt(photo.shape[0] * photo.shape[1]))
            for row, column in rng.integers(0, np.array(photo.shape[:2]) - side, (4, 2)):
                photo[row : row + side, column : column + side] = rng.random(3)
        maps.append(np.abs(shown - photo).mean(-1))
    assert transients.judge_residuals(maps).on == is_on
