"""Depth that a network sees up to a scale and a shift, fitted to points whose depth is known, and its normals."""

from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax.normals.from_depth import smoothed_depth_normals
from gsjax.scene.cameras import Camera

Kind = Literal["disparity", "depth"]

FEWEST_POINTS = 20  # that a photo's scale and shift are fitted to
LEAST_EXPLAINED = 0.3  # of the points' spread in depth, for the fit to say more of the photo than one depth for all
LEAST_POSITIVE = 0.9  # of the points, those in front of the camera after the fit
STEEPEST = 80.0  # degrees between normal and ray, from which on a slope is the smeared edge of something nearer

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


def edges(depth: Array, camera: Camera) -> Array:
    """`[H, W]` bool: pixels without depth, those on a slope steeper than `STEEPEST`, and their neighbours.

    A network draws the edge of an object as a slope from it to what lies behind, some pixels wide.
    """
    is_known = depth > 0
    inverse = jnp.where(is_known, 1 / jnp.where(is_known, depth, 1), 0)
    padded = jnp.pad(inverse, 1, mode="edge")
    along_x = 0.5 * (padded[1:-1, 2:] - padded[1:-1, :-2]) * camera.K[0, 0]
    along_y = 0.5 * (padded[2:, 1:-1] - padded[:-2, 1:-1]) * camera.K[1, 1]
    steep = jnp.hypot(along_x, along_y) > np.tan(np.radians(STEEPEST)) * inverse
    around = jnp.pad(steep | ~is_known, 1)
    height, width = depth.shape
    shifted = [around[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    return jnp.any(jnp.stack(shifted), axis=0)


def normals_of_depth(depth: np.ndarray, camera: Camera, reduction: int) -> np.ndarray:
    """`[H, W, 3]` float32 normals of a fitted depth map `[H, W]`, zero at `edges`; see `smoothed_depth_normals`."""
    depths = jnp.asarray(depth)
    return np.asarray(smoothed_depth_normals(depths, surface(depths, camera), camera, reduction=reduction))


def surface(depth: Array, camera: Camera) -> Array:
    """`[H, W]` 1 where a fitted depth map shows a surface, 0 at its `edges`."""
    return 1 - edges(depth, camera).astype(depth.dtype)


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
