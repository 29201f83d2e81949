"""The photos of the curves of detection have the effect of their strength."""

import numpy as np
import pytest

from gsjax.scene import Pixels, colors, frame_of

K = np.array([[50.0, 0, 40], [0, 50, 30], [0, 0, 1]], np.float32)
GREY = np.full((60, 80, 3), 188, np.uint8)  # half of the light


@pytest.fixture
def frame():
    return frame_of("a.png", np.eye(4, dtype=np.float32), K, Pixels(GREY))


def light(frame):
    return colors.srgb_to_linear(colors.shares(frame.pixels().image))


def test_photos_are_darker_by_a_half_normal_number_of_ev(scripts, frame):
    expose, seeds = scripts("effect_detection").expose, range(400)
    darker = [
        -np.log2(light(expose(frame, 0.4, np.random.default_rng(seed))).mean() / light(frame).mean()) for seed in seeds
    ]
    assert np.min(darker) > -0.01
    assert np.std(darker) == pytest.approx(0.4 * np.sqrt(1 - 2 / np.pi), rel=0.15)


def test_corners_are_darker_by_the_strength(scripts, frame):
    changed = light(scripts("effect_detection").darken_corners(frame, 0.8, np.random.default_rng(0)))
    assert np.log2(changed[30, 40] / changed[0, 0]) == pytest.approx(0.8, abs=0.03)


def test_a_camera_turns_by_pixels(scripts, frame):
    turn = scripts("effect_detection").turn
    turns = [turn(frame, 1.6, np.random.default_rng(seed)).viewmat for seed in range(400)]
    moved = [(K @ viewmat[:3, 2])[:2] / viewmat[2, 2] - K[:2, 2] for viewmat in turns]
    np.testing.assert_allclose(np.std(moved, axis=0), 1.6, rtol=0.15)


@pytest.mark.parametrize("share", [0.05, 0.4])
def test_a_square_covers_its_share_of_the_pixels(scripts, frame, share):
    covered = scripts("effect_detection").cover(frame, share, np.random.default_rng(0)).pixels().image
    is_square = (covered != GREY).any(axis=-1)
    assert is_square.mean() == pytest.approx(share, rel=0.1)
    assert len(np.unique(covered[is_square], axis=0)) == 1


def test_clouds_of_no_contrast_are_flat_grey(scripts):
    from plain_places import SKIES

    place, rng = SKIES["a yard, clouds"], np.random.default_rng(0)
    flat, clouds = (
        scripts("effect_detection").under_clouds(place, strength, rng).frames[0].pixels().image.astype(float)
        for strength in (0, 1)
    )
    is_sky = np.abs(flat - clouds).max(axis=-1) > 10
    assert 0.1 < is_sky.mean() < 0.9
    off = np.abs(flat[is_sky] - 204).max(axis=-1)  # 204 is 0.8 of the display's range.
    assert np.quantile(off, 0.9) < 8, "the noise of a photo; pixels at the house's edges show both"
