"""Where a photo was taken, by what finished Gaussians show: its pose alone, all else frozen.

Gauss-Newton on the differences of colours, from blurred pictures to sharp ones (after Lucas and Kanade, 1981). The
slopes are differences of renders: six pictures a round, and no program that is not there already.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from gsjax.effects.camera_twists import apply_twist
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera

BLURS = (0.01, 0.005, 0.0025, 0.0, 0.0, 0.0)  # of the width: standard deviations, one a round
PROBE = 0.05  # pixels that a move shifts the picture by for a slope
LARGEST = 0.05  # radians, or shares of the distance, in one round
_RIDGE = 1e-6  # of the mean slope squared: decides where the picture says nothing
_OUTLIER = 1.5  # standard deviations that count in full (Huber)

Draw = Callable[[Sequence[Camera]], Sequence[Picture]]
"""Cameras -> what the Gaussians show there."""


def align(camera: Camera, photo: np.ndarray, valid: np.ndarray, draw: Draw) -> Camera:
    """The camera that shows what a photo `[H, W, 3]` 0..1 shows at `valid` pixels `[H, W]`, near a given camera.

    The best of those that were tried, by the mean squared difference: the given one where none is better, or where
    there is nothing to compare.
    """
    best, least = camera, np.inf
    for blur in (*BLURS, None):
        (picture,) = draw([camera])
        error = float(np.mean(np.square(picture.colors - photo)[valid])) if valid.any() else 0.0
        if error < least:
            best, least = camera, error
        depths = picture.depth[valid & (picture.depth > 0)]
        if blur is None or not depths.size:
            return best
        unit = float(np.median(depths))
        camera = _moved(camera, jnp.asarray(_step(camera, picture, photo, valid, draw, unit, blur)), unit)
    return best


_moved = jax.jit(apply_twist)


def _step(
    camera: Camera, picture: Picture, photo: np.ndarray, valid: np.ndarray, draw: Draw, unit: float, blur: float
) -> np.ndarray:
    """`[6]` float32 twist of one round, shifts in `unit`s."""
    probe = PROBE / float(camera.K[0, 0])
    nearby = [_moved(camera, jnp.asarray(row), unit) for row in probe * np.eye(6, dtype=np.float32)]

    def visible(difference: np.ndarray) -> np.ndarray:
        """The pixels that count, blurred as if the others did not differ."""
        sigma = blur * camera.width
        return ndimage.gaussian_filter(difference * valid[..., None], (sigma, sigma, 0), mode="nearest")[valid]

    errors = visible(photo - picture.colors).reshape(-1)
    slopes = np.stack([visible(other.colors - picture.colors).reshape(-1) for other in draw(nearby)], -1) / probe
    size = np.abs(errors)
    spread = 1.4826 * float(np.median(size))
    weights = np.minimum(1.0, _OUTLIER * spread / np.maximum(size, 1e-12)) if spread > 0 else np.ones_like(size)
    normal = (slopes * weights[:, None]).T @ slopes
    normal += (_RIDGE * np.trace(normal) / 6 + 1e-12) * np.eye(6)
    twist = np.linalg.solve(normal, slopes.T @ (weights * errors))
    return (twist * min(1.0, LARGEST / max(float(np.abs(twist).max()), 1e-12))).astype(np.float32)
