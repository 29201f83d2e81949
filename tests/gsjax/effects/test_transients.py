"""Masks of what stood in one photo only: in closed form, at their bounds, and the quantile that they follow."""

from functools import partial
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import optax
from small_scenes import camera_at
from tolerances import assert_close

from gsjax.effects import transients
from gsjax.effects.simulation import mask_untrusted
from gsjax.rendering import View
from gsjax.scene.batches import Batch

CAMERA = camera_at(size=(32, 24))
EFFECTS = {"transients": transients.make_effect(optax.constant_schedule(transients.RATE))}


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
    is_trusted = np.asarray(
        transients.trusted_pixels(np.float32(np.log(0.05)), jnp.asarray(grey()), jnp.asarray(photo))
    )
    square = np.zeros((24, 32), bool)
    square[6:14, 8:18] = True
    # Its four corners, of whose windows it fills 9 of 25, are kept; what is beside it never goes.
    assert not is_trusted[7:13, 9:17].any()
    assert is_trusted[~square].all()
    assert (~is_trusted).sum() == square.sum() - 4 * 3
    assert transients.trusted_pixels(EFFECTS["transients"].initial, jnp.asarray(grey()), jnp.asarray(photo)).all()


def test_the_gradient_leads_to_the_quantile_and_the_value_is_zero():
    rng = np.random.default_rng(0)
    photo = grey() + rng.uniform(0, 0.3, (24, 32, 1)).astype(np.float32)
    valid = rng.random((24, 32)) < 0.7
    off = np.abs(photo - 0.5).mean(-1)[valid]

    def added(number):
        return mask_untrusted(EFFECTS, {"transients": number}, view(grey()), batch(photo, valid))[1]

    # It is zero where that share of the pixels is below the threshold.
    for quantile in (0.05, 0.2, 0.29):
        value, slope = jax.jit(jax.value_and_grad(added))(jnp.float32(np.log(quantile)))
        above = np.mean(off > quantile)
        assert value == 0
        expected = np.float32((1 - transients.QUANTILE) * (1 - above) - transients.QUANTILE * above)
        assert_close(slope, expected, kind="value", rtol=1e-4, atol=0, why="a sum of 500 numbers")


def test_masks_of_the_user_come_first():
    photo = grey()
    photo[6:14, 8:18] = 0.9
    valid = np.ones((24, 32), bool)
    valid[:, 20:] = False
    left, _ = mask_untrusted(EFFECTS, {"transients": jnp.float32(np.log(0.05))}, view(grey()), batch(photo, valid))
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
        return mask_untrusted(EFFECTS, {"transients": number}, view(colors), batch(photo, valid))[1]

    for number, photo, is_valid in product((-1e30, -80.0, 0.0, 1e30), (0.0, 1.0), (True, False)):
        value, slopes = added(jnp.float32(number), colors, grey(photo), np.full((24, 32), is_valid))
        assert value == 0
        assert np.isfinite(slopes[0]) and not np.any(slopes[1])
        assert (slopes[0] != 0) == is_valid
