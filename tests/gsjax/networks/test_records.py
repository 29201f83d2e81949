import numpy as np
import pytest
from scipy.integrate import quad

from gsjax.networks.records import (
    NETWORKS,
    Confidence,
    Size,
    canvas_fit,
    decode_normals,
    expected_error_degrees,
    is_reliable,
    normalize_picture,
)

FIXED, TOKENS = Size("fixed", sides=(384, 384)), Size("tokens", fit="stretch", multiple=14, tokens=1800)
PADDED, LONGEST = Size("multiple", multiple=32), Size("multiple", multiple=28, longest=1064)


@pytest.mark.parametrize(
    ("size", "photo", "fixed", "expected"),
    [
        (FIXED, (768, 512), (None, None), ((384, 384), 64, 0, 256, 384)),
        (TOKENS, (1600, 1067), (None, None), ((490, 728), 0, 0, 490, 728)),
        (PADDED, (641, 479), (None, None), ((480, 672), 0, 15, 479, 641)),
        (LONGEST, (1600, 900), (None, None), ((616, 1064), 9, 0, 598, 1064)),
        (PADDED, (640, 480), (None, 1280), ((480, 1280), 0, 320, 480, 640)),
        (Size("multiple", multiple=14, fit="stretch"), (100, 50), (None, None), ((56, 98), 0, 0, 56, 98)),
        (TOKENS, (5, 4000), (None, None), ((16800, 28), 0, 0, 16800, 28)),
    ],
)
def test_where_a_photo_goes(size, photo, fixed, expected):
    assert tuple(canvas_fit(size, *photo, fixed)) == expected


@pytest.mark.parametrize("kappa", [0.0, 1.0, 30.0])
def test_expected_errors_are_the_mean_angles_of_the_distribution(kappa):
    """Density on the sphere proportional to exp(-kappa angle), integrated."""
    mass, _ = quad(lambda t: np.exp(-kappa * t) * np.sin(t), 0, np.pi)
    mean, _ = quad(lambda t: t * np.exp(-kappa * t) * np.sin(t), 0, np.pi)
    np.testing.assert_allclose(expected_error_degrees(np.array(kappa)), np.degrees(mean / mass), rtol=1e-7)


def test_confidence_is_above_its_bound_and_error_below():
    np.testing.assert_array_equal(is_reliable(Confidence((), "probability", 0.5), np.array([0.4, 0.5, 0.6])), [0, 0, 1])
    np.testing.assert_array_equal(is_reliable(Confidence((), "kappa", 45.0), np.array([0.01, 1.0, 3.0])), [0, 0, 1])


def test_colours_and_normals_in_closed_form():
    white, black = np.full((1, 1, 3), 255, np.uint8), np.zeros((1, 1, 3), np.uint8)
    for name, low, high in [
        ("moge2", [0, 0, 0], [1, 1, 1]),
        ("metric3d", [0, 0, 0], [255, 255, 255]),
        ("omnidata", [0, 0, 0], [1, 1, 1]),
        ("dsine", [-2.1179, -2.0357, -1.8044], [2.2489, 2.4286, 2.6400]),
    ]:
        np.testing.assert_allclose(normalize_picture(NETWORKS[name], black)[0, 0], low, atol=1e-4)
        np.testing.assert_allclose(normalize_picture(NETWORKS[name], white)[0, 0], high, atol=1e-4)
    # A wall straight ahead, as each network writes it; then a wall on the left and a floor as one of them does.
    walls = {"moge2": (0, 0, -1), "metric3d": (0, 0, -2), "omnidata": (0.5, 0.5, 0), "dsine": (0, 0, 1)}
    for name, wall in walls.items():
        np.testing.assert_allclose(decode_normals(NETWORKS[name], np.float32([[wall]]))[0, 0], [0, 0, -1], atol=1e-6)
    left_and_floor = decode_normals(NETWORKS["dsine"], np.float32([[[-1, 0, 0], [0, 1, 0]]]))
    np.testing.assert_allclose(left_and_floor[0], [[1, 0, 0], [0, -1, 0]])
    np.testing.assert_array_equal(decode_normals(NETWORKS["moge2"], np.zeros((1, 1, 3), np.float32)), 0)
