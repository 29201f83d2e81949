"""What stood in some photos only."""

import numpy as np

from gsjax.effects.evidence import Evidence, unknown
from gsjax.effects.exposure import Gains

THRESHOLD = 0.25  # of the observations
FLOOR = 0.14  # what still scenes reach by sheen, shadows and wrong matches
OUTLIER = 4  # standard deviations
COST = "a mask a photo; nothing learned"


def judge(gains: Gains | None) -> Evidence:
    """On only where it is plain: tracks are what matched, so what came and went is rarely in them."""
    if gains is None or not len(gains.fit.residuals):
        return unknown("share of observations", THRESHOLD, COST, "needs points that three photos see")
    size = np.sqrt(np.square(gains.fit.residuals).mean(1))
    value = float((size > OUTLIER * gains.fit.sigma).mean())
    note = "colours off by 4 sigma after gains; sheen and shadows count too: give masks where something moved"
    return Evidence(value > THRESHOLD, value, "share of observations", FLOOR, THRESHOLD, COST, note)
