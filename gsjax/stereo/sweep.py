"""Dissimilarity of a photo and its neighbours at every depth, a plane sweep (Collins, CVPR 1996), and the best depths.

These are smooth by semi-global matching (Hirschmüller, PAMI 2008).
"""

from collections.abc import Sequence

import numpy as np

from gsjax.io.images import cv2
from gsjax.stereo.views import View

PLANES = 96
WINDOW = 5  # pixels, side of the square that is compared
FLAT = 1e-5  # variance of grey under which a window has no texture
UNLIKE = 2.0  # the largest dissimilarity, and that of pixels that no neighbour shows
STEP = 0.1  # cost of a neighbour at the next plane, in dissimilarities
JUMP = 1.0  # cost of a neighbour at any other plane

_HALF = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # OpenCV's pixel centres are whole numbers.


def inverse_depths(view: View) -> np.ndarray:
    """Return `[PLANES]` float64, from far to near, spaced evenly in disparity."""
    return np.linspace(1 / view.farthest, 1 / view.nearest, PLANES)


def dissimilarities(view: View, others: Sequence[View]) -> np.ndarray:
    """Compute 1 - the normalized cross-correlation with others, per pixel and plane parallel to the photo.

    It is the mean of the two best neighbours, of one at least, as a point may be hidden in the others.

    Returns:
        `[PLANES, H, W]` float32 in 0 to `UNLIKE`; exposure and contrast of a photo do not change them.
    """
    height, width = view.gray.shape
    mean = _windowed(view.gray)
    variance = _windowed(view.gray * view.gray) - mean * mean
    dissimilarity = np.empty((PLANES, height, width), np.float32)
    grays = [np.where(other.usable, other.gray, np.float32(-1)) for other in others]
    inverse_map = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    for plane, inverse in enumerate(inverse_depths(view)):
        first, second = (np.full((height, width), 1 - UNLIKE, np.float32) for _ in range(2))
        for other, gray in zip(others, grays, strict=True):
            warp = _homography(view, other, inverse)
            moved = cv2.warpPerspective(gray, warp, (width, height), flags=inverse_map, borderValue=-1.0)
            score = _correlation(view.gray, moved, mean, variance)
            score[moved < 0] = 1 - UNLIKE
            np.maximum(second, np.minimum(first, score), out=second)
            np.maximum(first, score, out=first)
        dissimilarity[plane] = 1 - (first if len(others) == 1 else (first + second) / 2)
    dissimilarity[:, ~view.usable | (variance <= FLAT)] = UNLIKE
    return dissimilarity


def _homography(view: View, other: View, inverse: float) -> np.ndarray:
    """Return the homography from pixels of a view to those of another, by the plane of this inverse depth."""
    turn = other.viewmat[:3, :3] @ view.viewmat[:3, :3].T
    shift = other.viewmat[:3, 3] - turn @ view.viewmat[:3, 3]
    between = other.K @ (turn + np.outer(shift, [0, 0, inverse])) @ np.linalg.inv(view.K)
    return np.linalg.inv(_HALF) @ between @ _HALF


def _correlation(gray: np.ndarray, moved: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    other_mean = _windowed(moved)
    other_variance = _windowed(moved * moved) - other_mean * other_mean
    together = _windowed(gray * moved) - mean * other_mean
    return together / np.sqrt(np.maximum(variance, FLAT) * np.maximum(other_variance, FLAT))


def _windowed(values: np.ndarray) -> np.ndarray:
    return cv2.boxFilter(values, -1, (WINDOW, WINDOW), borderType=cv2.BORDER_REFLECT)


def best_planes(dissimilarity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the plane of every pixel, interpolated between planes by a parabola.

    Of a dissimilarity `[D, H, W]`, D at least 3, these are `[H, W]` float32 places in planes from the first, and
    `[H, W]` float32 dissimilarity at the nearest plane.
    """
    costs = np.ascontiguousarray(np.moveaxis(dissimilarity, 0, -1))
    smooth = smoothed(costs)
    plane = np.argmin(smooth, axis=-1)
    inner = np.clip(plane, 1, smooth.shape[-1] - 2)
    before, here, after = (_at(smooth, inner + step) for step in (-1, 0, 1))
    bend = before - 2 * here + after
    vertex = np.clip((before - after) / np.where(bend > 0, 2 * bend, 1), -0.5, 0.5)
    places = plane.astype(np.float32) + np.where((bend > 0) & (plane == inner), vertex, 0)
    return places, _at(costs, plane)


def _at(values: np.ndarray, plane: np.ndarray) -> np.ndarray:
    return np.take_along_axis(values, plane[..., None], axis=-1)[..., 0]


def smoothed(costs: np.ndarray) -> np.ndarray:
    """Return `[H, W, D]` the sum of costs of the best paths that reach a pixel from four sides, at every plane."""
    total = np.zeros_like(costs)
    for paths, sums in ((costs, total), (costs.swapaxes(0, 1), total.swapaxes(0, 1))):
        _add_paths(paths, sums)
        _add_paths(paths[::-1], sums[::-1])
    return total


def _add_paths(costs: np.ndarray, total: np.ndarray) -> None:
    """Add to `[L, N, D]` the costs along N paths of L pixels, from the first to the last."""
    padded = np.full((costs.shape[1], costs.shape[2] + 2), np.inf, costs.dtype)
    path = padded[:, 1:-1]
    path[:] = 0
    best = np.empty_like(costs[0])
    for cost, sums in zip(costs, total, strict=True):
        least = path.min(axis=-1, keepdims=True)
        np.minimum(padded[:, :-2], padded[:, 2:], out=best)
        best += STEP
        np.minimum(best, path, out=best)
        np.minimum(best, least + JUMP, out=best)
        best -= least  # so that costs do not grow along a path
        np.add(best, cost, out=path)
        sums += path
