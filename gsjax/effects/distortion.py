"""Lens distortion: what its removal cost."""

import numpy as np

from gsjax.effects.evidence import Cost, Evidence
from gsjax.effects.observations import Observations

THRESHOLD = 0.03  # of a photo's pixels
WARN, WIDE = 0.10, 100.0  # of a photo's pixels; degrees across the diagonal
COST = Cost(note="nothing: photos are undistorted as they are read")


def judge(seen: Observations) -> Evidence:
    """On where undistorted frames show noticeably less than their photos did."""
    value = max(facts.lost_share for facts in seen.facts)
    angle = max(_diagonal_degrees(frame.K, frame.width, frame.height) for frame in seen.frames)
    note = f"share of a photo that its undistorted frame does not show; {angle:.0f} degrees across the diagonal"
    if value > WARN or angle > WIDE:
        note += "; wide for pinhole views: detail at the border is stretched or lost"
    return Evidence(value > THRESHOLD, value, "share of pixels", 0.0, THRESHOLD, COST, note)


def _diagonal_degrees(K: np.ndarray, width: int, height: int) -> float:
    corners = [((x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]) for x, y in ((0, 0), (width, height))]
    return float(sum(np.degrees(np.arctan(np.hypot(*corner))) for corner in corners))
