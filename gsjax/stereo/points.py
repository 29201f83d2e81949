"""Points of multi-view stereo depth, from which training starts."""

from typing import NamedTuple

import numpy as np

from gsjax.stereo.depths import PhotoDepths

CANDIDATES = 20  # for every returned point, when they are thinned
GROWTH = 1.1  # of the cells that thin points, per round


class StereoPoints(NamedTuple):
    """Points on the surface."""

    points: np.ndarray  # [P, 3] float32 world
    colors: np.ndarray  # [P, 3] uint8
    line: str  # their number, in words


def stereo_points(swept: PhotoDepths, count: int) -> StereoPoints:
    """Return at most `count` points of consistent stereo depth, evenly spread.

    Args:
        swept: Depth of one photo at least.
        count: At least 1.
    """
    points = np.concatenate([each.view.lift(each.depth) for each in swept.accepted])
    colors = np.concatenate([each.view.color[each.depth.is_confident] for each in swept.accepted])
    indices = spread_evenly(points, count)
    line = f"{len(indices):,} more points where photos agree about depth"
    return StereoPoints(points[indices].astype(np.float32), colors[indices], line)


def spread_evenly(points: np.ndarray, count: int) -> np.ndarray:
    """Return indices of one point in every occupied cell, of cells so large that there are at most `count`."""
    some = np.arange(0, len(points), max(len(points) // (CANDIDATES * count), 1))
    from_low = (points - points.min(axis=0))[some]
    size = max(float(from_low.max()), 1e-30) / (2 * count)
    while True:
        x, y, z = np.floor(from_low / size).astype(np.int64).T
        _, first = np.unique((x * (y.max() + 1) + y) * (z.max() + 1) + z, return_index=True)
        if len(first) <= count:
            return some[np.sort(first)]
        size *= GROWTH
