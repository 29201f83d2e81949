"""Depth by points of known depth: a network's, fitted to them in scale and shift, and planes through them alone."""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial import KDTree

from gsjax.normals.from_depth import smoothed_depth_normals
from gsjax.scene.cameras import Camera

Kind = Literal["disparity", "depth"]

FEWEST_POINTS = 20  # that a photo's scale and shift are fitted to
LEAST_EXPLAINED = 0.3  # of the points' spread in depth, for the fit to say more of the photo than one depth for all
LEAST_POSITIVE = 0.9  # of the points, those in front of the camera after the fit
STEEPEST = 80.0  # degrees between normal and ray, from which on a slope is the smeared edge of something nearer
NEAREST = 8  # points that a pixel's plane goes through
LARGEST_MISFIT = 0.04  # of that plane to them, relative to the inverse depth, for it to be a surface
REACH = 3.0  # times the usual spacing of points: farther from the nearest one nothing is known

_PAIRS = 400  # of points, each a candidate for scale and shift
_ROUNDS = 10  # of reweighting
_TUKEY = 4.685  # of the residuals' deviation, beyond which a point does not count (95 % efficient on a normal noise)
_MAD = 1.4826  # standard deviations in a median absolute deviation, of normal noise


class DepthFit(NamedTuple):
    """Scale and shift of one photo: `scale * value + shift` is the inverse depth (disparity), or the depth."""

    scale: float
    shift: float
    error: float  # median of |fitted / true - 1| over the points
    explained: float  # 1 - (that error / the error of one value for all points)^2: 0 where the network says nothing
    points: int

    @property
    def fault(self) -> str | None:
        """Why it must not be used, in words; None: it may be."""
        if self.points < FEWEST_POINTS:
            return f"{self.points} points, of {FEWEST_POINTS} that a fit takes"
        if self.scale <= 0:
            return "what the network sees nearer is farther away"
        if self.explained < LEAST_EXPLAINED:
            return f"explains {max(self.explained, 0.0):.2f} of the points' depths, less than {LEAST_EXPLAINED}"
        return None


def fit_depth(values: np.ndarray, depths: np.ndarray, kind: Kind) -> DepthFit:
    """The scale and shift that fit most points: the best pair of points, then Tukey's reweighting from there.

    Residuals are relative, as those of triangulated points are.

    Args:
        values: `[P]` of the network at the points.
        depths: `[P]` camera z of the points, positive.
        kind: What the network gives.

    Returns:
        A `DepthFit`, of scale 0 where there are too few points or all have one value.
    """
    targets = 1 / depths if kind == "disparity" else depths
    rows = np.stack([values, np.ones_like(values)], -1).astype(np.float64) / targets[:, None]
    flat = float(np.median(targets)) if len(targets) else 0.0
    if len(values) < FEWEST_POINTS or not np.ptp(values) > 0:
        return DepthFit(0.0, flat, np.inf, 0.0, len(values))
    best = _reweighted(rows, _best_pair(rows))
    error = float(np.median(np.abs(rows @ best - 1)))
    of_one_value = float(np.median(np.abs(flat / targets - 1)))
    explained = 1 - (error / max(of_one_value, 1e-12)) ** 2
    if np.mean(rows @ best > 0) < LEAST_POSITIVE:
        explained = 0.0
    return DepthFit(float(best[0]), float(best[1]), error, float(explained), len(values))


def fitted_depth(values: np.ndarray, fit: DepthFit, kind: Kind) -> np.ndarray:
    """`[H, W]` float32 camera z of a network's `[H, W]` values; 0 where it is not positive."""
    fitted = fit.scale * values.astype(np.float64) + fit.shift
    positive = fitted > 1e-9
    safe = np.where(positive, fitted, 1.0)
    return np.where(positive, 1 / safe if kind == "disparity" else safe, 0.0).astype(np.float32)


def surface(depth: Array, camera: Camera) -> Array:
    """`[H, W]` 1 where fitted depth shows a surface; 0 without depth, at slopes over `STEEPEST`, and next to them.

    A network draws the edge of an object as a slope from it to what is behind, some pixels wide.
    """
    is_known = depth > 0
    inverse = jnp.where(is_known, 1 / jnp.where(is_known, depth, 1), 0)
    padded = jnp.pad(inverse, 1, mode="edge")
    along_x = 0.5 * (padded[1:-1, 2:] - padded[1:-1, :-2]) * camera.K[0, 0]
    along_y = 0.5 * (padded[2:, 1:-1] - padded[:-2, 1:-1]) * camera.K[1, 1]
    steep = jnp.hypot(along_x, along_y) > np.tan(np.radians(STEEPEST)) * inverse
    none = jax.lax.reduce_window(steep | ~is_known, False, jax.lax.bitwise_or, (3, 3), (1, 1), "SAME")
    return 1 - none.astype(depth.dtype)


def normals_of_depth(depth: np.ndarray, camera: Camera, reduction: int) -> np.ndarray:
    """`[H, W, 3]` float32 `smoothed_depth_normals` of a fitted depth map `[H, W]`, zero off its `surface`."""
    depths = jnp.asarray(depth)
    return np.asarray(smoothed_depth_normals(depths, surface(depths, camera), camera, reduction=reduction))


def _best_pair(rows: np.ndarray) -> np.ndarray:
    """`[2]` scale and shift through two of the points, with the least median residual of all."""
    rng = np.random.default_rng(0)
    pairs = rows[rng.integers(0, len(rows), (_PAIRS, 2))]
    usable = np.abs(np.linalg.det(pairs)) > 1e-12 * np.abs(pairs).max(axis=(1, 2)) ** 2
    candidates = np.linalg.solve(pairs[usable], np.ones((usable.sum(), 2, 1)))[..., 0]
    if not len(candidates):
        return np.zeros(2)
    return candidates[np.argmin(np.median(np.abs(candidates @ rows.T - 1), axis=1))]


def _reweighted(rows: np.ndarray, start: np.ndarray) -> np.ndarray:
    solution = start
    for _ in range(_ROUNDS):
        residuals = np.abs(rows @ solution - 1)
        deviation = _MAD * max(float(np.median(residuals)), 1e-7)
        weights = np.square(np.maximum(1 - np.square(residuals / (_TUKEY * deviation)), 0))
        normal = np.einsum("pi,p,pj->ij", rows, weights, rows)
        if np.linalg.cond(normal) > 1e14:
            return solution
        solution = np.linalg.solve(normal, np.einsum("pi,p->i", rows, weights))
    return solution


def sparse_depth(rays: np.ndarray, depths: np.ndarray, K: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Camera z of a view's pixels, where points around them are on a plane.

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
