"""What tells the axes of maps: side walls above all."""

import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.normals.axes import (
    NAMED_AXES,
    OTHER_SIGNS,
    apply_axes,
    axes_verdict,
    axis_signs,
    detect_axes,
    facing_votes,
    written_axes,
)

K = np.array([[60.0, 0, 50], [0, 60, 40], [0, 0, 1]])


def corridor(width=100, height=80, walls=True):
    """Normals seen along a corridor: floor, ceiling, the end, and walls at the sides where it has them."""
    y, x = np.mgrid[0:height, 0:width] + 0.5
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], -1)
    side = 1.0 if walls else 1e9
    reach = np.stack([side / np.abs(rays[..., 0]), 1 / np.abs(rays[..., 1]), np.full_like(x, 4.0)], -1)
    first = reach.argmin(-1)
    normals = np.zeros((height, width, 3))
    for axis in range(3):
        at = first == axis
        normals[at, axis] = -np.sign(rays[at, axis])
    return normals.astype(np.float32)


def noisy(normals, degrees, seed=0):
    noise = np.random.default_rng(seed).normal(size=normals.shape) * np.radians(degrees)
    has_normal = np.any(normals, -1, keepdims=True)
    turned = normals + noise
    return (turned / np.linalg.norm(turned, axis=-1, keepdims=True) * has_normal).astype(np.float32)


@pytest.mark.parametrize("signs", [(1, 1, 1), (1, -1, -1), (-1, 1, 1)])
def test_a_corridor_names_the_mirroring_that_it_was_written_with(signs):
    maps = [noisy(corridor(), 10, seed) * np.float32(signs) for seed in range(4)]
    verdict = axes_verdict(sum(facing_votes(each, K) for each in maps))
    is_right = signs == (1, 1, 1)
    expected = "confirmed" if is_right else f"doubtful: mirrored by {written_axes(np.float32(signs))} "
    assert verdict.startswith(expected)
    axes, score, margin = detect_axes(maps, [corridor()] * 4)
    np.testing.assert_array_equal(axes, signs)
    assert score > 0.9 and margin > 0.2
    restored = apply_axes(maps[0], axes)
    assert restored.dtype == np.float32
    np.testing.assert_array_equal(restored, noisy(corridor(), 10, 0))


def test_without_side_walls_x_cannot_be_told():
    votes = sum(facing_votes(noisy(corridor(walls=False), 5, seed), K) for seed in range(4))
    verdict = axes_verdict(votes)
    assert verdict.startswith("not contradicted")
    assert verdict.endswith("a mirroring by -x+y+z")
    assert axes_verdict(np.zeros((7, 2), int)).count(",") == 6, "nothing to tell by"


def test_of_mirrorings_that_serve_about_as_well_the_one_with_fewer_signs_is_named():
    votes = np.zeros((7, 2), int)
    two, one = (OTHER_SIGNS.tolist().index(signs) for signs in ([1, -1, -1], [-1, 1, 1]))
    assert two < one
    votes[two, 1], votes[one, 1] = 1000, 950
    assert axes_verdict(votes).startswith("doubtful: mirrored by -x+y+z 950 of the 950 ")
    votes[one, 1] = 890
    assert axes_verdict(votes).startswith("doubtful: mirrored by +x-y-z 1,000 of the 1,000 ")


def test_few_side_walls_are_enough_for_the_comparison_with_depth():
    """Walls at the side on 4 percent of the view: of a plain sample of the pixels they are nearly nothing."""
    reference = corridor(walls=False)
    reference[:, :4] = [1, 0, 0]
    foreign = noisy(reference, 15) * np.float32([1, -1, -1])
    signs, score, margin = detect_axes([foreign], [reference], pixels_per_map=600)
    assert written_axes(signs) == "+x-y-z"
    assert score > 0.9 and margin > 0.2, "of a plain sample 0.08: twice the share of the walls"
    _, _, margin = detect_axes([noisy(corridor(walls=False), 15)], [corridor(walls=False)], pixels_per_map=600)
    assert margin < 0.02
    frontal = np.zeros((9, 9, 3), np.float32)
    frontal[..., 2] = -1
    assert detect_axes([frontal], [frontal])[1:] == (1, 0)
    assert detect_axes([0 * frontal], [frontal])[1:] == (0, 0)


def test_axes_have_names_and_anything_else_is_an_error():
    np.testing.assert_array_equal([axis_signs(n)[1:] for n in ("opengl", "dsine")], [[-1, -1], [-1, -1]])
    assert [axis_signs(n)[0] for n in ("opengl", "dsine")] == [1, -1], "a side wall tells them apart"
    for wrong in ("", "xyz", "+x+y", "+x+y+z ", "OpenGL"):
        with pytest.raises(InputError, match="expected three signs such as .*, or one of " + ", ".join(NAMED_AXES)):
            axis_signs(wrong)
