"""What is behind all Gaussians: colours by direction in closed form, their gradients, and where they start."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from photographed_wall import wall, with_tracks
from small_scenes import camera_at
from tolerances import assert_close

from gsjax.effects import background
from gsjax.effects.diagnosis import diagnose
from gsjax.effects.observations import observe
from gsjax.errors import InputError
from gsjax.planning.effects import choose_effects
from gsjax.planning.validation import ValidationGain
from gsjax.rendering import backdrop
from gsjax.scene import with_pixels
from gsjax.scene.cameras import Camera
from gsjax.settings import Model, Settings
from gsjax.training.plan import plan

CAMERA = camera_at((0.4, -0.3, 0.2), (1.0, 0.5, 4.0), size=(8, 6), focal=7.0)
C1 = 0.4886025119029199  # Of the harmonics of degree 1.


def rays(camera):
    """`[H, W, 3]` unit world directions of the pixels, numpy."""
    viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    local = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], -1)
    world = local @ viewmat[:3, :3]
    return world / np.linalg.norm(world, axis=-1, keepdims=True)


def test_a_sky_is_a_function_of_the_direction_in_the_world():
    coefficients = backdrop.constant_coefficients(np.array([0.2, 0.5, 0.9]), 4)
    coefficients[1:4] = np.random.default_rng(0).normal(size=(3, 3)) * 0.1
    x, y, z = np.moveaxis(rays(CAMERA), -1, 0)[..., None]
    expected = np.array([0.2, 0.5, 0.9]) + C1 * (-y * coefficients[1] + z * coefficients[2] - x * coefficients[3])
    colors = jax.jit(backdrop.color_behind)(coefficients, CAMERA)
    assert_close(colors, np.float32(expected), atol=1e-6, rtol=0, why="sums of single numbers")
    color = jnp.array([0.1, 0.2, 0.3])
    assert backdrop.color_behind(color, CAMERA) is color


def weighted_sum(coefficients, viewmat, alphas, camera):
    """Over a picture that covers so much: what the loss sees of a sky."""
    weights = jnp.asarray(np.random.default_rng(1).normal(size=(6, 8, 3)), coefficients.dtype)
    under = backdrop.color_behind(coefficients, Camera(viewmat, camera.K, camera.width, camera.height))
    return jnp.sum((1 - alphas)[..., None] * jnp.broadcast_to(under, weights.shape) * weights)


def test_gradients_to_sky_and_camera_are_finite_differences(x64):
    rng = np.random.default_rng(2)
    viewmat, K = (jnp.asarray(np.asarray(m), jnp.float64) for m in (CAMERA.viewmat, CAMERA.K))
    camera, alphas = Camera(viewmat, K, 8, 6), jnp.asarray(rng.random((6, 8)))
    coefficients = jnp.asarray(0.1 * rng.normal(size=(25, 3)) + backdrop.constant_coefficients(np.full(3, 0.5), 4))
    value = jax.jit(lambda c, v: weighted_sum(c, v, alphas, camera))
    slopes = jax.jit(jax.grad(lambda c, v: weighted_sum(c, v, alphas, camera), (0, 1)))(coefficients, viewmat)
    for _ in range(4):
        towards = (rng.normal(size=(25, 3)), np.r_[rng.normal(size=(3, 4)), np.zeros((1, 4))])
        ends = [value(coefficients + s * towards[0], viewmat + s * towards[1]) for s in (1e-6, -1e-6)]
        expected = sum(np.sum(np.asarray(slope) * way) for slope, way in zip(slopes, towards, strict=True))
        np.testing.assert_allclose((ends[0] - ends[1]) / 2e-6, expected, rtol=1e-6)


def test_hard_cases_in_value_and_gradient():
    """Nothing open gives a sky no gradient at all; a photo of nothing but sky gives it one; black and beyond holds."""
    coefficients = jnp.asarray(backdrop.constant_coefficients(np.full(3, 0.5), 4))
    value = jax.jit(jax.value_and_grad(lambda c, a: weighted_sum(c, CAMERA.viewmat, a, CAMERA)))
    total, slopes = value(coefficients, jnp.ones((6, 8)))
    assert total == 0 and not np.any(slopes)
    _, slopes = value(coefficients, jnp.zeros((6, 8)))
    assert np.isfinite(slopes).all() and np.abs(slopes[0]).max() > 0.01
    for size in (-1e3, -1e30, 1e30):
        total, slopes = value(coefficients * 0 + jnp.float32(size), jnp.full((6, 8), 0.5))
        assert np.isfinite(total) and np.isfinite(slopes).all()
    total, slopes = value(jnp.asarray(backdrop.constant_coefficients(np.full(3, -1.0), 4)), jnp.zeros((6, 8)))
    assert total == 0 and not np.any(slopes)  # Light is never less than none.


def painted(sky):
    """The wall's photos with the upper third repainted by `sky(rows, columns)`, nothing matched there."""
    scene = wall()
    lower = with_tracks(scene, scene.tracks().rays[:, 1] > 0)

    def outdoors(frame):
        image = frame.pixels().image.copy()
        image[:24] = sky(*np.mgrid[:24, :96])
        return with_pixels(frame, frame.pixels()._replace(image=image))

    return replace(lower, frames=tuple(map(outdoors, scene.frames)))


def test_a_sky_starts_as_the_photos_show_it():
    flat = background.initial(observe(painted(lambda y, x: np.array([200, 220, 250]))))
    assert flat.shape == (1, 3)
    assert_close(backdrop.color_behind(jnp.asarray(flat), CAMERA), np.float32([200, 220, 250]) / 255, rtol=0, atol=5e-3,
                 why="a place of the grid may hold an edge")  # fmt: skip
    shaded = background.initial(observe(painted(lambda y, x: (200 + y[..., None]) * np.array([1.0, 1.0, 1.1]))))
    assert shaded.shape == (25, 3)
    np.testing.assert_array_equal(background.initial(observe(wall())), np.zeros((1, 3)))


def confirm(observations, proposed):
    """A validation in which every effect passes."""
    return dict.fromkeys(proposed, ValidationGain(1.0, 0.1))


def test_a_sky_of_the_colour_that_a_run_lays_anyway_is_off():
    white = painted(lambda y, x: np.array([255, 255, 255]))
    auto = plan(Settings(model=Model(background="white")))
    laid = choose_effects("auto", auto, white, confirm)
    assert "background" not in laid.effects
    record = laid.evidence["evidence"]["background"]
    assert not record["on"] and record["evidence"] == 1.0
    assert record["note"].startswith("off: the background is white; ")
    over_black = choose_effects(
        "auto", replace(auto, background="black"), white, lambda *_: pytest.fail("nothing is in doubt")
    )
    assert "background" in over_black.effects
    record = over_black.evidence["evidence"]["background"]
    assert record["on"] and record["note"].startswith("simulated: certain without validation; ")


def test_an_open_sky_is_seen_and_mattes_answer_it():
    outdoors = painted(lambda y, x: np.full(3, 255))
    evidence = diagnose(outdoors).effects["background"]
    assert evidence.on and "1.00, 1.00, 1.00, the same in all photos; pure white" in evidence.note
    flat = painted(lambda y, x: np.full(3, 220))
    assert not diagnose(flat).effects["background"].on, "plaster looks the same"
    matte = np.full((72, 96), 255, np.uint8)
    frames = tuple(with_pixels(f, f.pixels()._replace(matte=matte)) for f in outdoors.frames)
    cut_out = replace(outdoors, frames=frames)
    assert not diagnose(cut_out).effects["background"].on
    with pytest.raises(InputError, match="have mattes"):
        choose_effects("background", plan(Settings()), cut_out)
