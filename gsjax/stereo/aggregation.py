"""Smooth depth from dissimilarities: semi-global matching (Hirschmüller, PAMI 2008)."""

import numpy as np

STEP = 0.1  # cost of a neighbour at the next plane, in dissimilarities
JUMP = 1.0  # cost of a neighbour at any other plane


def best_planes(dissimilarities: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the plane of every pixel, interpolated between planes by a parabola.

    Args:
        dissimilarities: `[D, H, W]` float32, D at least 3.

    Returns:
        `[H, W]` float32 places in planes from the first, and `[H, W]` float32 dissimilarity at the nearest plane.
    """
    costs = np.ascontiguousarray(np.moveaxis(dissimilarities, 0, -1))
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
