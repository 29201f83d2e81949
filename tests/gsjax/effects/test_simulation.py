"""What effects do to a picture, and the masks of what stood in one photo only: in closed form and at their bounds."""

from functools import partial
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from small_scenes import camera_at
from tolerances import assert_close

from gsjax.effects import exposure, transients, vignetting
from gsjax.effects.appearance import Appearance, fit_colors, without_appearance
from gsjax.effects.simulation import LIMIT, learning_rate, mask_untrusted, photograph
from gsjax.rendering import View
from gsjax.scene import Pixels, frame_of
from gsjax.scene.batches import Batch

CAMERA = camera_at(size=(32, 24))
GAINS = np.array([[0.2, -0.1, 0.0], [0.1, 0.3, -0.4]], np.float32)
RATE_OF_A_RUN = learning_rate(3000)
EFFECTS = {
    "exposure": exposure.make_effect(GAINS, RATE_OF_A_RUN),
    "vignetting": vignetting.make_effect([[-0.5, 0.1]], np.zeros(2), RATE_OF_A_RUN),
}
NUMBERS = {name: jnp.asarray(effect.initial) for name, effect in EFFECTS.items()}


def batch(photo=1, matte=None):
    valid = jnp.ones((24, 32), bool)
    return Batch(CAMERA, jnp.zeros((24, 32, 3), jnp.float32), valid, matte, None, jnp.int32(photo))


def view(seed=0):
    rng = np.random.default_rng(seed)
    colors, alphas = rng.random((24, 32, 3)), rng.random((24, 32))
    return View(jnp.asarray(colors, jnp.float32), jnp.asarray(alphas, jnp.float32), None, None)


@jax.jit
def photo_colors(numbers, rendered_view, target, under):
    return photograph(EFFECTS, numbers, rendered_view, target, under).colors


BLACK = jnp.zeros(3, jnp.float32)


def test_a_photo_is_the_light_times_its_gains_and_the_fall_off():
    rendered_view = view()
    colors = photo_colors(NUMBERS, rendered_view, batch(), BLACK)
    K = np.asarray(CAMERA.K)
    x, y = np.meshgrid(np.arange(32) + 0.5, np.arange(24) + 0.5)
    tangent2 = ((x - K[0, 2]) / K[0, 0]) ** 2 + ((y - K[1, 2]) / K[1, 1]) ** 2
    factor = np.exp((-0.5 * tangent2 + 0.1 * tangent2**2)[..., None] + (GAINS - GAINS.mean(0))[1])
    assert_close(colors, np.asarray(rendered_view.colors) * factor)
    look = Appearance(tuple((GAINS - GAINS.mean(0))[1].tolist()), (-0.5, 0.1))
    frame = frame_of("0.png", np.asarray(CAMERA.viewmat), K, Pixels(np.full((24, 32, 3), 100, np.uint8)))
    assert_close(look.factor(frame), factor.astype(np.float32))
    assert_close(
        without_appearance(frame, look).pixels().image, np.clip(np.rint(100 / factor), 0, 255).astype(np.uint8)
    )


def test_a_background_that_mattes_put_there_was_in_front_of_no_camera():
    white = jnp.ones(3, jnp.float32)
    rendered_view = view()._replace(colors=jnp.ones((24, 32, 3), jnp.float32), alphas=jnp.zeros((24, 32), jnp.float32))
    matte = jnp.zeros((24, 32), jnp.float32)
    assert_close(photo_colors(NUMBERS, rendered_view, batch(matte=matte), white), rendered_view.colors)
    assert not np.allclose(photo_colors(NUMBERS, rendered_view, batch(), white), rendered_view.colors)


def test_a_white_pixel_bounds_the_light_from_below_only():
    """Photo 1 is darker by a factor in red, brighter in green: e^-0.05, e^0.2, e^-0.2."""
    gains = {"exposure": EFFECTS["exposure"]}
    colors = np.full((24, 32, 3), 0.9, np.float32)
    colors[0, 0] = 1.3  # already wrong without effects
    rendered_view = view()._replace(colors=jnp.asarray(colors))
    photo = np.ones((24, 32, 3), np.float32)
    photo[12:] = 0.9
    white = batch()
    white = Batch(white.camera, jnp.asarray(photo), white.valid, None, None, white.photo)

    @jax.jit
    def colors_of(numbers):
        return photograph(gains, {"exposure": numbers}, rendered_view, white, BLACK).colors

    factor = np.exp((GAINS - GAINS.mean(0))[1])
    expected = colors * factor
    expected[:12, :, 1] = 1.0
    expected[0, 0, 1] = 1.3
    assert_close(colors_of(NUMBERS["exposure"]), expected)
    slopes = jax.grad(lambda numbers: jnp.sum(colors_of(numbers)[:12]))(NUMBERS["exposure"])
    assert np.abs(slopes[:, [0, 2]]).min() > 1 and not np.any(slopes[:, 1])


@jax.jit
@jax.value_and_grad
def brightness(numbers):
    return jnp.sum(photo_colors(numbers, view(), batch(), BLACK))


def test_what_all_photos_share_is_no_gain():
    moved = {**NUMBERS, "exposure": NUMBERS["exposure"] + 0.7}
    (value, slopes), (expected, _) = brightness(NUMBERS), brightness(moved)
    assert_close(value, expected)
    slopes = slopes["exposure"]
    assert_close(slopes.sum(0), np.zeros(3, np.float32), atol=1e-3, rtol=0, why="sums of 768 pixels cancel")
    assert np.abs(slopes).max() > 10


@pytest.mark.parametrize("size", [1e2, 1e30])
def test_numbers_beyond_their_bounds_give_finite_values_and_gradients(size):
    numbers = jax.tree.map(lambda leaf: leaf * jnp.float32(size), NUMBERS)
    colors = photo_colors(numbers, view(), batch(), BLACK)
    assert np.isfinite(colors).all() and np.max(colors) <= np.exp(2 * LIMIT)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(brightness(numbers)))


def test_the_fitted_colours_are_the_affine_map_where_there_is_one():
    rng = np.random.default_rng(0)
    colors, map_ = rng.random((8, 9, 3)).astype(np.float32), rng.random((3, 3))
    image = (colors @ map_ + [0.1, 0.2, 0.3]).astype(np.float32)
    valid = rng.random((8, 9)) < 0.5
    assert_close(fit_colors(colors, np.where(valid[..., None], image, 9).astype(np.float32), valid), image)
    assert_close(fit_colors(colors, image, np.zeros((8, 9), bool)), colors)


MASKS = {"transients": transients.make_effect(optax.constant_schedule(transients.RATE))}


def batch_of(image, valid=None):
    valid = np.ones((24, 32), bool) if valid is None else valid
    return Batch(CAMERA, jnp.asarray(image, jnp.float32), jnp.asarray(valid), None, None, jnp.int32(0))


def view_of(colors):
    return View(jnp.asarray(colors, jnp.float32), jnp.ones((24, 32), jnp.float32), None, None)


def grey(value=0.5):
    return np.full((24, 32, 3), value, np.float32)


def test_a_square_is_left_out_and_single_pixels_stay():
    photo = grey()
    photo[6:14, 8:18] = 0.9
    photo[20, 3], photo[0, 0], photo[23, 31] = 0.0, 1.0, 1.0
    is_trusted = np.asarray(
        transients.trusted_pixels(np.float32(np.log(0.05)), jnp.asarray(grey()), jnp.asarray(photo))
    )
    square = np.zeros((24, 32), bool)
    square[6:14, 8:18] = True
    # Its four corners, of whose windows it fills 9 of 25, are kept; what is beside it never goes.
    assert not is_trusted[7:13, 9:17].any()
    assert is_trusted[~square].all()
    assert (~is_trusted).sum() == square.sum() - 4 * 3
    assert transients.trusted_pixels(MASKS["transients"].initial, jnp.asarray(grey()), jnp.asarray(photo)).all()


def test_the_gradient_leads_to_the_quantile_and_the_value_is_zero():
    rng = np.random.default_rng(0)
    photo = grey() + rng.uniform(0, 0.3, (24, 32, 1)).astype(np.float32)
    valid = rng.random((24, 32)) < 0.7
    off = np.abs(photo - 0.5).mean(-1)[valid]

    def added(number):
        return mask_untrusted(MASKS, {"transients": number}, view_of(grey()), batch_of(photo, valid))[1]

    slope_of = jax.jit(jax.value_and_grad(added))
    for quantile in (0.05, 0.2, 0.29):
        value, slope = slope_of(jnp.float32(np.log(quantile)))
        above = np.mean(off > quantile)
        assert value == 0
        expected = np.float32((1 - transients.QUANTILE) * (1 - above) - transients.QUANTILE * above)
        assert_close(slope, expected, kind="value", rtol=1e-4, atol=0, why="a sum of 500 numbers")


def test_masks_of_the_user_come_first():
    photo = grey()
    photo[6:14, 8:18] = 0.9
    valid = np.ones((24, 32), bool)
    valid[:, 20:] = False
    left, _ = mask_untrusted(MASKS, {"transients": jnp.float32(np.log(0.05))}, view_of(grey()), batch_of(photo, valid))
    assert not left.valid[:, 20:].any()
    assert not left.valid[8:12, 10:16].any()
    assert left.valid[:5, :20].all()


def test_hard_cases_in_value_and_gradient():
    """Black and saturated photos, photos without a valid pixel, renders far beyond white, a quantile at either end."""
    colors = grey(0.5)
    colors[0, 0] = [1e30, -1e30, 0.5]

    @jax.jit
    @partial(jax.value_and_grad, argnums=(0, 1))
    def added(number, colors, photo, valid):
        return mask_untrusted(MASKS, {"transients": number}, view_of(colors), batch_of(photo, valid))[1]

    for number, photo, is_valid in product((-1e30, -80.0, 0.0, 1e30), (0.0, 1.0), (True, False)):
        value, slopes = added(jnp.float32(number), colors, grey(photo), np.full((24, 32), is_valid))
        assert value == 0
        assert np.isfinite(slopes[0]) and not np.any(slopes[1])
        assert (slopes[0] != 0) == is_valid
