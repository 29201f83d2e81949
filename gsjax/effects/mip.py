"""Sampling: one surface seen by large pixels and by small ones."""

import numpy as np

from gsjax.effects.evidence import Evidence, gaussian_cost, unknown
from gsjax.effects.observations import Observations

THRESHOLD = 2.0  # an octave
SHARE = 0.1  # of the points must see that much
COST = gaussian_cost(12, 0, "two determinants a splat, and back")


def judge(seen: Observations) -> Evidence:
    """On where a pixel covers, on the same point, more than twice as much in one photo as in another."""
    spans = _spans(seen)
    if not spans.size:
        return unknown("x", THRESHOLD, COST, "no point is matched in two photos")
    value = float(np.quantile(spans, 1 - SHARE))
    note = f"coarsest over finest sampling of a point, exceeded by {100 * SHARE:.0f} % of them"
    note += "; pixel_filter=mip serves, which fast and balanced have" if value > THRESHOLD else ""
    return Evidence(value > THRESHOLD, value, "x", 1.0, THRESHOLD, COST, note)


def _spans(seen: Observations) -> np.ndarray:
    """`[P]` ratio of the largest to the smallest depth / focal of every point that two photos see."""
    rates = np.full((2, len(seen.points)), [[np.inf], [0.0]])
    for index, frame in enumerate(seen.frames):
        rows = seen.point[seen.photo == index]
        rate = (seen.points[rows] @ frame.viewmat[2, :3] + frame.viewmat[2, 3]) / np.sqrt(frame.K[0, 0] * frame.K[1, 1])
        rows, rate = rows[rate > 0], rate[rate > 0]
        rates[0, rows], rates[1, rows] = np.minimum(rates[0, rows], rate), np.maximum(rates[1, rows], rate)
    twice = np.bincount(seen.point, minlength=len(seen.points)) > 1
    return (rates[1] / rates[0])[twice & (rates[1] > 0)]
