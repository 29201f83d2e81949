"""Gauss-Newton steps of single poses on their reprojection errors: how far cameras contradict the tracks."""

from typing import NamedTuple

import numpy as np

from gsjax.effects.observations import Observations

SIGNIFICANT = 3  # standard errors
FEWEST = 8  # observations of a photo
_ROUNDS, _OUTLIER = 5, 1.5  # of reweighting; standard deviations that count in full (Huber)


class Step(NamedTuple):
    """A Gauss-Newton step of one photo's pose."""

    shift: float  # median shift of its points in the picture, pixels
    error: float  # standard error of that
    turn: np.ndarray  # [3] of the camera about its centre, along the world's axes, radians
    move: np.ndarray  # [3] of its centre, scene units

    @property
    def is_sure(self) -> bool:
        """Whether it is more than its own error."""
        return self.shift > SIGNIFICANT * self.error


def gauss_newton_steps(observations: Observations) -> tuple[Step | None, ...]:
    """The robust Gauss-Newton step of every photo on its reprojection errors, points fixed; None of too few points."""
    return tuple(_step(observations, index) for index in range(len(observations.frames)))


def _step(observations: Observations, index: int) -> Step | None:
    rows = observations.photo == index
    if rows.sum() < FEWEST:
        return None
    frame = observations.frames[index]
    viewmat, K = frame.viewmat.astype(np.float64), frame.K.astype(np.float64)
    local = observations.points[observations.point[rows]] @ viewmat[:3, :3].T + viewmat[:3, 3]
    front = local[:, 2] > 1e-6
    if front.sum() < FEWEST:
        return None
    local, observed = local[front], observations.pixels[rows][front]
    x, y, z = local.T
    focal = K[[0, 1], [0, 1]]
    errors = observed - (local[:, :2] / z[:, None] * focal + K[:2, 2])
    zero, one = np.zeros_like(x), np.ones_like(x)
    # Of a turn about the camera's axes (radians), then of a move in units of depth.
    depth = float(np.median(z))
    across = np.stack([-x * y / z**2, 1 + (x / z) ** 2, -y / z, one * depth / z, zero, -x / z**2 * depth], -1)
    down = np.stack([-(1 + (y / z) ** 2), x * y / z**2, x / z, zero, one * depth / z, -y / z**2 * depth], -1)
    slopes = np.stack([across, down], axis=1) * focal[:, None]  # [M, 2, 6]
    weights, twist, inverse, sigma = np.ones(len(x)), np.zeros(6), np.eye(6), 0.0
    for _ in range(_ROUNDS):
        normal = np.einsum("mca,mcb,m->ab", slopes, slopes, weights)
        inverse = np.linalg.inv(normal + 1e-9 * np.trace(normal) * np.eye(6))
        twist = inverse @ np.einsum("mca,mc,m->a", slopes, errors, weights)
        left = np.linalg.norm(errors - slopes @ twist, axis=1)
        sigma = float(np.median(left)) / 1.1774  # of one coordinate, were both normal
        weights = np.minimum(1.0, _OUTLIER * sigma / np.maximum(left, 1e-12))
    shift = float(np.median(np.linalg.norm(slopes @ twist, axis=1)))
    # Points that turn before a camera are a camera that turns the other way.
    turn, move = -viewmat[:3, :3].T @ twist[:3], -depth * viewmat[:3, :3].T @ twist[3:]
    variances = np.einsum("mca,ab,mcb->m", slopes, inverse, slopes) * sigma**2
    return Step(shift, float(np.sqrt(np.median(variances))), turn, move)
