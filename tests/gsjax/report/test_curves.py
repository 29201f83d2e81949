import numpy as np
import pytest
from tolerances import assert_close

from gsjax.report.curves import BOTTOM, LEFT, RIGHT, TOP, Curve, chart


def points(text):
    return np.array([pair.split(",") for pair in text.split()], float)


def test_a_band_goes_along_the_most_and_back_along_the_least():
    low, high = np.array([0.0, 2.0]), np.array([4.0, 4.0])
    drawn = chart("y", "steps", [Curve("y", np.array([5, 10]), (low + high) / 2, low, high)])
    outline = points(drawn.lines[0].band)
    middle, up = (LEFT + RIGHT) / 2, BOTTOM - TOP
    expected = [(middle, BOTTOM), (RIGHT, BOTTOM - up / 2), (RIGHT, TOP), (middle, TOP)]
    assert_close(outline, np.array(expected), atol=0.006, rtol=0, why="two digits are written")


@pytest.mark.parametrize("value", [0.0, -3.5, 36000.0, 1e-7])
def test_a_line_that_does_not_move_is_drawn_between_ticks(value):
    drawn = chart("y", "steps", [Curve("y", np.array([1, 2]), np.full(2, value))])
    heights = points(drawn.lines[0].points)[:, 1]
    assert np.isfinite(heights).all() and TOP < heights[0] == heights[1] < BOTTOM


@pytest.mark.parametrize(("low", "high"), [(0.0497, 0.2264), (14.64, 30.3), (4248, 36000), (1e-6, 3e-6), (-2, 2)])
def test_ticks_are_round_increasing_and_hold_the_line(low, high):
    drawn = chart("y", "steps", [Curve("y", np.array([1, 2]), np.array([low, high]))])
    values = [float(text.replace(",", "")) for _, text in drawn.y_ticks]
    assert values == sorted(set(values)) and 3 <= len(values) <= 8
    assert values[0] <= low < high <= values[-1]
    for (y, _), value in zip(drawn.y_ticks, values, strict=True):
        share = (value - values[0]) / (values[-1] - values[0])
        assert y == pytest.approx(BOTTOM - (BOTTOM - TOP) * share, abs=0.01), "what is written is where it stands"
