"""Foreign normal maps brought to our axes: x right, y down, z forward in the camera, towards it."""

from collections.abc import Sequence

import numpy as np

# The ways to mirror axes, up to the sign of the whole, which an unsigned cosine cannot tell.
SIGN_PATTERNS = np.array([[1, 1, 1], [-1, 1, 1], [1, -1, 1], [1, 1, -1]], np.float32)


def detect_axes(maps: Sequence[np.ndarray], references: Sequence[np.ndarray]) -> tuple[np.ndarray, float, float]:
    """Which axes of foreign normal maps point the other way: the mirroring that agrees best with reference normals.

    Args:
        maps: `[H, W, 3]` each, any sign convention, zero where there is no normal.
        references: As many, of the same views in our convention, such as `depth_normals` of a trained scene.

    Returns:
        `[3]` signs (+1 or -1) for `apply_axes`, with the sign of the whole such that maps face the camera; the mean
        |cos| that they reach, 0..1; and by how much the next best mirroring falls short of it. A score under 0.5 or
        a margin under 0.02 is doubtful; without a pixel to compare both are 0.
    """
    pairs = [_unit_pairs(m, r) for m, r in zip(maps, references, strict=True)]
    products = np.concatenate([a * b for a, b in pairs])
    if not len(products):
        return SIGN_PATTERNS[0], 0.0, 0.0
    cosines = products @ SIGN_PATTERNS.T
    scores = np.abs(cosines).mean(axis=0)
    best = int(scores.argmax())
    facing = 1.0 if cosines[:, best].mean() >= 0 else -1.0
    runner_up = np.delete(scores, best).max()
    return np.float32(facing) * SIGN_PATTERNS[best], float(scores[best]), float(scores[best] - runner_up)


def apply_axes(normals: np.ndarray, signs: np.ndarray) -> np.ndarray:
    """A map `[H, W, 3]` with its axes turned by `[3]` signs, of the map's dtype."""
    return normals * signs.astype(normals.dtype)


def _unit_pairs(normals: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`[P, 3]` float64 unit normals of both at the pixels where both have one."""
    lengths = [np.linalg.norm(np.asarray(m, np.float64), axis=-1) for m in (normals, reference)]
    both = (lengths[0] > 0.5) & (lengths[1] > 0.5)
    return normals[both] / lengths[0][both][:, None], reference[both] / lengths[1][both][:, None]
