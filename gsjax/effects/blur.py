"""Blurred photos: found and named, not simulated."""

import numpy as np

from gsjax.effects.evidence import Cost, Evidence
from gsjax.effects.observations import Observations

THRESHOLD = 0.5  # of the median sharpness, lost
DROP = 0.7
COST = Cost(note="nothing: photos would be left out, not simulated")
_SHOWN = 5


def judge(seen: Observations) -> Evidence:
    """On where a photo has less than half of the sharpness that the median photo has; the note names those."""
    sharpness = np.array([facts.sharpness for facts in seen.facts])
    median = float(np.median(sharpness))
    lost = 1 - sharpness / median if median > 0 else np.zeros(len(sharpness))
    blurred = np.flatnonzero(lost > THRESHOLD)
    names = [seen.frames[index].name for index in blurred[np.argsort(-lost[blurred])]]
    note = "the least sharp photo against the median one"
    if names:
        note = f"blurred: {', '.join(names[:_SHOWN])}" + (
            f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
        )
        note += f"; {int((lost > DROP).sum())} by more than {100 * DROP:.0f} %, better left out"
    spread = float(1.4826 * np.median(np.abs(lost - np.median(lost))))
    return Evidence(bool(names), float(lost.max()), "of median sharpness lost", spread, THRESHOLD, COST, note)
