"""Vignetting: photos that are darker towards their corners."""

import numpy as np

from gsjax.effects.evidence import Evidence, unknown
from gsjax.effects.exposure import Gains
from gsjax.effects.gains import project
from gsjax.effects.observations import Observations

THRESHOLD = 0.1  # EV at the corner
SIGNIFICANT = 5  # standard errors
_GROUPS = 20  # of radii in a picture
COST = "1 number and its two moments a camera; one product a pixel"


def corner(seen: Observations, gains: Gains) -> tuple[float, float]:
    """Fall-off at half a diagonal from the principal point, EV, negative where corners are darker; its standard error.

    The slope of log light on the squared radius, once what photos and points explain is taken out of both: one point
    nearer to the middle in one photo than in another. Observations of a photo count as one in the error, since what
    the model leaves of it is shared.
    """
    data, weights = gains.data, gains.fit.weights
    radii = seen.radii2[data.rows][:, None]
    across = project(radii, data, weights)[1][:, 0]
    light = gains.fit.residuals.mean(1)
    leverage = max(float(weights @ np.square(across)), 1e-12)
    slope = float(weights @ (across * light)) / leverage
    scores = np.bincount(data.photo, weights * across * (light - slope * across), data.num_photos)
    return slope, float(np.sqrt(np.square(scores).sum()) / leverage)


def profile(seen: Observations, gains: Gains) -> tuple[np.ndarray, np.ndarray, float]:
    """For a picture: squared radii `[B]`, the light there against the middle's `[B]` in EV, and the corner's."""
    data, weights = gains.data, gains.fit.weights
    radii = seen.radii2[data.rows]
    across = project(radii[:, None], data, weights)[1][:, 0]
    slope, _ = corner(seen, gains)
    light = gains.fit.residuals.mean(1) + slope * (radii - across)
    groups = np.array_split(np.argsort(radii), min(_GROUPS, len(radii)))
    means = [(radii[rows].mean(), light[rows].mean()) for rows in groups]
    return *np.array(means).T, slope  # pyright: ignore[reportReturnType]


def judge(seen: Observations, gains: Gains | None) -> Evidence:
    """On where the fall-off shows, and is sure."""
    if gains is None:
        return unknown("EV", THRESHOLD, COST, "needs points that three photos see")
    slope, error = corner(seen, gains)
    on = -slope > max(THRESHOLD, SIGNIFICANT * error)
    note = f"how much darker a corner is than the middle; needs {SIGNIFICANT} standard errors, has"
    note += f" {-slope / max(error, 1e-6):.0f}"
    return Evidence(bool(on), -slope, "EV", error, THRESHOLD, COST, note)
