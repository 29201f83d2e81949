"""Depth of a photo from the points that structure from motion matched in it: planes through their neighbours."""

import numpy as np
from scipy.spatial import KDTree

NEAREST = 8  # points that a pixel's plane goes through
LARGEST_MISFIT = 0.04  # of that plane to them, relative to the inverse depth, for it to be a surface
REACH = 3.0  # times the usual spacing of points: farther from the nearest one nothing is known


def sparse_depth(rays: np.ndarray, depths: np.ndarray, K: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Camera z of a view's pixels, where points around them lie on a plane.

    Args:
        rays: `[P, 2]` x/z and y/z of the points in the camera.
        depths: `[P]` their camera z, positive.
        K: `[3, 3]` pixels of the view, centres at +0.5.
        shape: Its height and width.

    Returns:
        `[H, W]` float32, 0 where it is not known.
    """
    if len(depths) < 2 * NEAREST:
        return np.zeros(shape, np.float32)
    at = rays * K[[0, 1], [0, 1]] + K[:2, 2]
    tree = KDTree(at)
    spacing = float(np.median(tree.query(at, k=NEAREST)[0][:, -1]) / np.sqrt(NEAREST / np.pi))
    x, y = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    pixels = np.stack([x.ravel(), y.ravel()], -1)
    distances, nearest = tree.query(pixels, k=NEAREST)
    inverse = 1 / depths[nearest]
    scale = np.maximum(distances[:, -1:], 1e-6)
    weights = np.exp(-2 * np.square(distances / scale))
    rows = np.concatenate([np.ones_like(inverse)[..., None], (at[nearest] - pixels[:, None]) / scale[..., None]], -1)
    normal = np.einsum("pki,pk,pkj->pij", rows, weights, rows) + np.diag([0, 1e-4, 1e-4])
    planes = np.linalg.solve(normal, np.einsum("pki,pk->pi", rows, weights * inverse)[..., None])[..., 0]
    residual = np.einsum("pki,pi->pk", rows, planes) - inverse
    misfit = np.sqrt(np.sum(weights * residual**2, -1) / np.sum(weights, -1))
    value = planes[:, 0]
    is_known = (value > 0) & (misfit < LARGEST_MISFIT * value) & (distances[:, 0] < REACH * spacing)
    return np.where(is_known, 1 / np.where(is_known, value, 1), 0).reshape(shape).astype(np.float32)
