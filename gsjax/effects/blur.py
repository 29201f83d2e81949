"""Blurred photos: found and named, and left out where others see what they see; not simulated."""

import numpy as np

from gsjax.effects.evidence import Cost, Evidence
from gsjax.effects.observations import Observations

THRESHOLD = 0.5  # of the median sharpness, lost
DROP = 0.7  # A photo that lost more is left out of training,
SEEN_BESIDES = 0.9  # if two others see so many of its points.
COST = Cost(note="nothing: photos are left out, not simulated")
_SHOWN = 5


def judge(seen: Observations) -> Evidence:
    """On where a photo has less than half of the sharpness that the median photo has; the note names those."""
    lost = _lost(seen)
    blurred = np.flatnonzero(lost > THRESHOLD)
    names = [seen.frames[index].name for index in blurred[np.argsort(-lost[blurred])]]
    note = "the least sharp photo against the median one"
    if names:
        more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
        note = (
            f"blurred: {', '.join(names[:_SHOWN])}{more}; {int((lost > DROP).sum())} by more than {100 * DROP:.0f} %,"
            f" training leaves {len(photos_to_leave_out(seen)) or 'none'} out"
        )
    spread = float(1.4826 * np.median(np.abs(lost - np.median(lost))))
    return Evidence(bool(names), float(lost.max()), "of median sharpness lost", spread, THRESHOLD, COST, note)


def photos_to_leave_out(seen: Observations) -> tuple[str, ...]:
    """Names of the photos that are too blurred to be trained on and that nothing depends on.

    Nine tenths of what was matched in such a photo must be seen by two sharper ones that are trained on; without tracks
    nobody knows, and none is left out. Held-out photos are not trained on anyway, and are scored as they are.
    """
    trained = np.array([not frame.held_out for frame in seen.frames])
    blurred = trained & (_lost(seen) > DROP)
    stays = (trained & ~blurred)[seen.photo]
    others = np.bincount(seen.point[stays], minlength=len(seen.points))
    found = []
    for index in np.flatnonzero(blurred):
        points = seen.point[seen.photo == index]
        if len(points) and np.mean(others[points] >= 2) >= SEEN_BESIDES:
            found.append(seen.frames[index].name)
    return tuple(found)


def _lost(seen: Observations) -> np.ndarray:
    """`[V]` share of the median photo's sharpness that each photo lacks."""
    sharpness = np.array([facts.sharpness for facts in seen.facts])
    median = float(np.median(sharpness))
    return 1 - sharpness / median if median > 0 else np.zeros(len(sharpness))
