"""Points to start from where a data set has none: random, where its cameras look."""

import numpy as np

COUNT = 30_000
_SYNTHETIC_HALF_WIDTH = 1.3  # 3DGS, Blender scenes
_SYNTHETIC_FAR = 10.0  # half widths: cameras that are farther off look at something else
_SEED = 0


def points_in_view(viewmats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Random points `[P, 3]` float64 around the place nearest to all optical axes, and colours uint8 of middle tones.

    Their cube is as large as the median distance of the cameras `[V, 4, 4]` from that place; no point is nearer to a
    camera than a quarter of it.
    """
    rng = np.random.default_rng(_SEED)
    centers, focus, reach = _looked_at(viewmats)
    points = focus + rng.uniform(-reach, reach, (2 * COUNT, 3))
    nearest = np.min([np.linalg.norm(points - center, axis=1) for center in centers], axis=0)
    clear = points[nearest > 0.25 * reach][:COUNT]
    return clear, _mid_tones(rng)[: len(clear)]


def points_in_synthetic_cube(viewmats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `points_in_view`, but in [-1.3, 1.3]^3, as in 3DGS, where cameras are around that cube."""
    _, focus, reach = _looked_at(viewmats)
    if np.abs(focus).max() > _SYNTHETIC_HALF_WIDTH or not 1 < reach / _SYNTHETIC_HALF_WIDTH < _SYNTHETIC_FAR:
        return points_in_view(viewmats)
    rng = np.random.default_rng(_SEED)
    points = rng.uniform(-_SYNTHETIC_HALF_WIDTH, _SYNTHETIC_HALF_WIDTH, (COUNT, 3))
    return points, _mid_tones(rng)


def _looked_at(viewmats: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Centres `[V, 3]`, the place `[3]` nearest to all optical axes, and the median distance of the cameras from it.

    Of parallel axes the place is one spread of the cameras ahead.
    """
    centers, axes = -np.einsum("nji,nj->ni", viewmats[:, :3, :3], viewmats[:, :3, 3]), viewmats[:, 2, :3]
    spread = np.linalg.norm(centers - centers.mean(0), axis=1).max() or 1.0
    ahead = centers.mean(0) + spread * axes.mean(0)
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    weak = 1e-3 * len(centers) * np.eye(3)
    focus = np.linalg.solve(across.sum(0) + weak, np.einsum("nij,nj->i", across, centers) + weak @ ahead)
    return centers, focus, float(np.median(np.linalg.norm(centers - focus, axis=1))) or 1.0


def _mid_tones(rng: np.random.Generator) -> np.ndarray:
    return rng.integers(64, 192, (COUNT, 3), dtype=np.uint8)
