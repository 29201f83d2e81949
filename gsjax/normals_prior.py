"""Normal maps to train against: from depth, from smoothed depth, and foreign ones brought to our axes.

Maps are `[H, W, 3]`, unit, in the camera frame (x right, y down, z forward), towards the camera, and zero where there
is no normal.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax.cameras import Camera, unproject
from gsjax.numerics import safe_normalize

# The ways to mirror axes, up to the sign of the whole, which an unsigned cosine cannot tell.
SIGN_PATTERNS = np.array([[1, 1, 1], [-1, 1, 1], [1, -1, 1], [1, 1, -1]], np.float32)


def depth_normals(depth: Array, camera: Camera) -> Array:
    """Normals of a depth map, by central differences of the unprojected points.

    At the image border, and where the neighbour on one side has no depth, the difference is one-sided.

    Args:
        depth: `[H, W]` camera z, scene units; 0 where there is none.
        camera: The view.

    Returns:
        `[H, W, 3]`, differentiable in `depth`; zero where the pixel, or both neighbours along an axis, have no depth.
    """
    if depth.shape != (camera.height, camera.width):
        raise ValueError(f"{depth.shape=} does not match {camera.height=}, {camera.width=}")
    points, valid = unproject(depth, camera), depth > 0
    along_x, has_x = _difference(points, valid, axis=1)
    along_y, has_y = _difference(points, valid, axis=0)
    # Measured in pixels' footprints, so that neither the scene's scale nor the focal length decides what is zero.
    footprint = jnp.where(valid, depth, 1.0)[..., None] / camera.K[0, 0]
    normals = safe_normalize(jnp.cross(along_y / footprint, along_x / footprint))
    return jnp.where((valid & has_x & has_y)[..., None], normals, 0.0)


def _difference(points: Array, valid: Array, axis: int) -> tuple[Array, Array]:
    """Next minus previous point along an image axis, the pixel itself for a missing one; and whether any is there."""
    size = valid.shape[axis]
    width = [(1, 1) if a == axis else (0, 0) for a in range(2)]
    padded_points, padded_valid = jnp.pad(points, [*width, (0, 0)]), jnp.pad(valid, width)

    def neighbour(start: int) -> tuple[Array, Array]:
        there = jax.lax.slice_in_dim(padded_points, start, start + size, axis=axis)
        exists = jax.lax.slice_in_dim(padded_valid, start, start + size, axis=axis)
        return jnp.where(exists[..., None], there, points), exists

    (behind, has_behind), (ahead, has_ahead) = neighbour(0), neighbour(2)
    return ahead - behind, has_ahead | has_behind


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
