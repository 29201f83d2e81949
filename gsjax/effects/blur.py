"""Blurred photos, one or all: named, and left out where others show the same; not simulated."""

import numpy as np

from gsjax.effects.kinds import EffectKind, Evidence, Findings
from gsjax.effects.observations import Observations

THRESHOLD = 0.5  # of the median sharpness, lost
DROP = 0.7  # A photo that lost more is left out of training,
SEEN_BESIDES = 0.9  # if two others see so many of its points.
SHARP_EDGE = 1.5  # pixels: photos whose sharpest edges are twice as wide lack half of their resolution
_MOST_NAMED = 5


def judge(findings: Findings) -> Evidence:
    """Judge whether photos lack half of the median photo's sharpness, which the note names, or all lack resolution."""
    observations = findings.observations
    lost, blurred_by = _lost(observations), _lost_by_all(observations)
    blurred = np.flatnonzero(lost > THRESHOLD)
    names = [observations.frames[index].name for index in blurred[np.argsort(-lost[blurred])]]
    note = "the least sharp photo against the median one"
    if names:
        more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
        note = (
            f"blurred: {', '.join(names[:_MOST_NAMED])}{more}; {int((lost > DROP).sum())} by more than"
            f" {100 * DROP:.0f} %, training leaves {len(photos_to_leave_out(observations)) or 'none'} out"
        )
    if blurred_by > THRESHOLD:
        note += f"; all photos are blurred: their sharpest edges are {SHARP_EDGE / (1 - blurred_by):.1f} pixels wide,"
        note += f" {SHARP_EDGE} in sharp photos; half the size shows as much"
    spread = float(1.4826 * np.median(np.abs(lost - np.median(lost))))
    value = max(float(lost.max()), blurred_by)
    return Evidence(value > THRESHOLD, value, "of median sharpness lost", spread, THRESHOLD, note)


def _lost_by_all(observations: Observations) -> float:
    """Share of the resolution that the median photo lacks, by its sharpest edges; 0 where photos have no edges."""
    widths = np.array([facts.edge_width for facts in observations.facts if facts.edge_width > 0])
    return max(0.0, 1 - SHARP_EDGE / float(np.median(widths))) if 2 * len(widths) > len(observations.facts) else 0.0


def photos_to_leave_out(observations: Observations) -> tuple[str, ...]:
    """Names of the photos that are too blurred to be trained on and that nothing depends on.

    Nine tenths of what was matched in such a photo must be seen by two sharper ones that are trained on. Without
    tracks none is left out. Held-out photos are not trained on anyway, and are scored as they are.
    """
    trained = np.array([not frame.held_out for frame in observations.frames])
    blurred = trained & (_lost(observations) > DROP)
    stays = (trained & ~blurred)[observations.photo]
    others = np.bincount(observations.point[stays], minlength=len(observations.points))
    names = []
    for index in np.flatnonzero(blurred):
        points = observations.point[observations.photo == index]
        if len(points) and np.mean(others[points] >= 2) >= SEEN_BESIDES:
            names.append(observations.frames[index].name)
    return tuple(names)


def _lost(observations: Observations) -> np.ndarray:
    """`[V]` share of the median photo's sharpness that each photo lacks."""
    sharpness = np.array([facts.sharpness for facts in observations.facts])
    median = float(np.median(sharpness))
    return 1 - sharpness / median if median > 0 else np.zeros(len(sharpness))


EFFECT = EffectKind(judge, is_proposed=False, photos_to_leave_out=photos_to_leave_out)
