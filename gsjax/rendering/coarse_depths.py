"""The depths that views show, on a coarse grid of their pixels: what photos say of any point, many at once."""

from typing import NamedTuple

import numpy as np

from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera, landing, thinned_K

LONGEST = 320  # Pixels of a coarse view: 300 kB, so that all views of a capture fit.
SAME_SURFACE = 0.05  # Share of the depth up to which two depths are of one surface.


class CoarseDepth(NamedTuple):
    """One view."""

    camera: Camera  # numpy
    depth: np.ndarray  # [H, W] float32 camera z, 0 where the view says nothing


def coarse_depth(camera: Camera, picture: Picture, longest: int = LONGEST) -> CoarseDepth:
    """Every k-th pixel of a picture, so that its longer side has at most `longest`; depths are not mixed."""
    every = max(1, -(-max(camera.width, camera.height) // longest))
    first = every // 2
    depth = np.ascontiguousarray(picture.depth[first::every, first::every], np.float32)
    K = thinned_K(np.asarray(camera.K), every)
    height, width = depth.shape
    coarse = Camera(np.asarray(camera.viewmat), K.astype(np.float32), width, height)
    return CoarseDepth(coarse, np.where(np.isfinite(depth), depth, 0))


def depths_at(points: np.ndarray, view: CoarseDepth) -> tuple[np.ndarray, np.ndarray]:
    """`[P]` camera z of `[P, 3]` world points, and `[P]` the depth that the view shows there; 0 where it shows none."""
    camera = view.camera
    rows, columns, depths, inside = landing(points, np.asarray(camera.viewmat), np.asarray(camera.K), view.depth.shape)
    return depths, np.where(inside, view.depth[rows, columns], 0).astype(np.float64)
