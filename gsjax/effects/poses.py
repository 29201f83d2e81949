"""Poses that do not agree with the tracks."""

from typing import NamedTuple

import numpy as np

from gsjax.effects.evidence import Evidence, unknown
from gsjax.effects.observations import Observations

THRESHOLD = 0.3  # pixels
SIGNIFICANT = 3  # standard errors
SHARE = 0.2  # of the photos must want to move
FEWEST = 8  # observations of a photo
COST = "72 bytes a photo, moments included; gradients of the cameras"
_ROUNDS, _OUTLIER = 5, 1.5  # of reweighting; standard deviations that count in full (Huber)


class Step(NamedTuple):
    """A Gauss-Newton step of one photo's pose."""

    shift: float  # median shift of its points in the picture, pixels
    error: float  # standard error of that


def steps(seen: Observations) -> tuple[Step | None, ...]:
    """The robust Gauss-Newton step of every photo on its reprojection errors, points fixed; None of too few points."""
    return tuple(_step(seen, index) for index in range(len(seen.frames)))


def judge(seen: Observations, found: tuple[Step | None, ...]) -> Evidence:
    """On where a fifth of the photos would move their points by more than a third of a pixel, and are sure of it."""
    known = [step for step in found if step is not None]
    if not known:
        return unknown("px", THRESHOLD, COST, "needs keypoints matched in the photos")
    value = float(np.quantile([step.shift for step in known], 1 - SHARE))
    sure = np.mean([step.shift > max(THRESHOLD, SIGNIFICANT * step.error) for step in known])
    noise = float(np.median([step.error for step in known]))
    note = f"the step that {100 * SHARE:.0f} % of the photos exceed, against their tracks"
    note += "; poses and points that are wrong together do not show; reported"
    return Evidence(bool(sure >= SHARE), value, "px", noise, THRESHOLD, COST, note)


def _step(seen: Observations, index: int) -> Step | None:
    rows = seen.photo == index
    if rows.sum() < FEWEST:
        return None
    frame = seen.frames[index]
    viewmat, K = frame.viewmat.astype(np.float64), frame.K.astype(np.float64)
    local = seen.points[seen.point[rows]] @ viewmat[:3, :3].T + viewmat[:3, 3]
    front = local[:, 2] > 1e-6
    if front.sum() < FEWEST:
        return None
    local, observed = local[front], seen.pixels[rows][front]
    x, y, z = local.T
    focal = K[[0, 1], [0, 1]]
    errors = observed - (local[:, :2] / z[:, None] * focal + K[:2, 2])
    zero, one = np.zeros_like(x), np.ones_like(x)
    # Of a turn about the camera's axes (radians), then of a move in units of depth.
    depth = float(np.median(z))
    slopes = (
        np.stack(
            [
                np.stack([-x * y / z**2, 1 + (x / z) ** 2, -y / z, one * depth / z, zero, -x / z**2 * depth], -1),
                np.stack([-(1 + (y / z) ** 2), x * y / z**2, x / z, zero, one * depth / z, -y / z**2 * depth], -1),
            ],
            axis=1,
        )
        * focal[:, None]
    )  # [M, 2, 6]
    weights, twist, inverse, sigma = np.ones(len(x)), np.zeros(6), np.eye(6), 0.0
    for _ in range(_ROUNDS):
        normal = np.einsum("mca,mcb,m->ab", slopes, slopes, weights)
        inverse = np.linalg.inv(normal + 1e-9 * np.trace(normal) * np.eye(6))
        twist = inverse @ np.einsum("mca,mc,m->a", slopes, errors, weights)
        left = np.linalg.norm(errors - slopes @ twist, axis=1)
        sigma = float(np.median(left)) / 1.1774  # of one coordinate, were both normal
        weights = np.minimum(1.0, _OUTLIER * sigma / np.maximum(left, 1e-12))
    shift = float(np.median(np.linalg.norm(slopes @ twist, axis=1)))
    variances = np.einsum("mca,ab,mcb->m", slopes, inverse, slopes) * sigma**2
    return Step(shift, float(np.sqrt(np.median(variances))))
