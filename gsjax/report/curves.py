"""Curves of a run as the numbers of an SVG: where lines, ticks and marks are in a picture of fixed size."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from gsjax.report.figures import round_ticks

WIDTH, HEIGHT = 432, 236  # of a chart, SVG units
LEFT, RIGHT, TOP, BOTTOM = 50, 410, 12, 200  # of what the axes enclose
TICKS = 5  # most, along either axis


class Curve(NamedTuple):
    """One line: P points, and the range that it is the mean of where runs are pooled."""

    label: str
    x: np.ndarray  # [P]
    y: np.ndarray  # [P]
    low: np.ndarray | None = None  # [P] least of the runs
    high: np.ndarray | None = None  # [P] most of the runs
    color: int = 0  # index into the colours of the page
    faint: bool = False  # drawn thin, behind what counts


class Chart(NamedTuple):
    """What a template draws: every position in SVG units, y down."""

    title: str
    unit: str  # of the x axis
    lines: list[tuple[Curve, str, str]]  # with points "x,y x,y ...", and those of its range's outline or none
    x_ticks: list[tuple[float, str]]
    y_ticks: list[tuple[float, str]]
    marks: list[tuple[float, str]]  # upright lines with a name: where a phase ends


def chart(title: str, unit: str, curves: Sequence[Curve], marks: Sequence[tuple[float, str]] = ()) -> Chart | None:
    """Places curves between axes: x from 0 to the last point, y from tick to tick around all of them.

    Curves of fewer than two points are left out. None where no other is left.
    """
    curves = [curve for curve in curves if len(curve.x) > 1]
    if not curves:
        return None
    values = np.concatenate([each for c in curves for each in (c.y, c.low, c.high) if each is not None])
    end = max(float(c.x.max()) for c in curves)
    x_ticks, y_ticks = _ticks(0.0, end), _ticks(float(values.min()), float(values.max()))
    bottom, top = y_ticks[0], y_ticks[-1]

    def across(x: Any) -> Any:
        return LEFT + (RIGHT - LEFT) * np.asarray(x, float) / end

    def up(y: Any) -> Any:
        return BOTTOM - (BOTTOM - TOP) * (np.asarray(y, float) - bottom) / (top - bottom)

    def points(x: np.ndarray, y: np.ndarray) -> str:
        return " ".join(f"{a:.2f},{b:.2f}" for a, b in zip(across(x), up(y), strict=True))

    def band(c: Curve) -> str:
        if c.low is None or c.high is None:
            return ""
        return points(np.concatenate([c.x, c.x[::-1]]), np.concatenate([c.low, c.high[::-1]]))

    return Chart(
        title,
        unit,
        [(curve, points(curve.x, curve.y), band(curve)) for curve in curves],
        [(round(float(across(x)), 2), f"{x:,g}") for x in x_ticks if x <= end],
        [(round(float(up(y)), 2), f"{y:,.10g}") for y in y_ticks],
        [(round(float(across(x)), 2), name) for x, name in marks if 0 < x < end],
    )


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers from below `low` to above `high`."""
    if low == high:  # A line that does not move still has room around it.
        low, high = low - max(abs(low), 1) / 2, high + max(abs(high), 1) / 2
    ticks = round_ticks(low, high, TICKS)
    digits = 1 - math.floor(math.log10(ticks[1] - ticks[0]))
    return [round(tick, max(digits, 0)) + 0.0 for tick in ticks]
