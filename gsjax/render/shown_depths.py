"""The depths that views show, on a coarse grid of their pixels: what photos say of any point, many at once."""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from gsjax.cameras import Camera, thinned_K
from gsjax.render.gallery import Picture

LONGEST = 320  # Pixels of a coarse view: 300 kB, so that all views of a capture fit.
SAME_SURFACE = 0.05  # Share of the depth up to which two depths are of one surface.


class ShownDepth(NamedTuple):
    """One view."""

    camera: Camera  # numpy
    depth: np.ndarray  # [H, W] float32 camera z, 0 where the view says nothing


def coarse_depth(camera: Camera, picture: Picture, longest: int = LONGEST) -> ShownDepth:
    """Every k-th pixel of a picture, so that its longer side has at most `longest`; depths are not mixed."""
    every = max(1, -(-max(camera.width, camera.height) // longest))
    first = every // 2
    depth = np.ascontiguousarray(picture.depth[first::every, first::every], np.float32)
    K = thinned_K(np.asarray(camera.K), every)
    height, width = depth.shape
    coarse = Camera(np.asarray(camera.viewmat), K.astype(np.float32), width, height)  # pyright: ignore[reportArgumentType]
    return ShownDepth(coarse, np.where(np.isfinite(depth), depth, 0))


def noting(cameras: Sequence[Camera], pictures: Iterable[Picture], notes: list[ShownDepth]) -> Iterator[Picture]:
    """The same pictures; the coarse depth of each is appended to `notes` as it passes."""
    for camera, picture in zip(cameras, pictures, strict=True):
        notes.append(coarse_depth(camera, picture))
        yield picture


def depths_at(points: np.ndarray, view: ShownDepth) -> tuple[np.ndarray, np.ndarray]:
    """`[P]` camera z of `[P, 3]` world points, and `[P]` the depth that the view shows there; 0 where it shows none."""
    height, width = view.depth.shape
    viewmat, K = np.asarray(view.camera.viewmat, np.float64), np.asarray(view.camera.K, np.float64)
    x, y, z = (points @ viewmat[:3, :3].T + viewmat[:3, 3]).T
    in_front = z > 1e-6
    depths = np.where(in_front, z, 1.0)
    columns = np.floor(np.clip(x / depths * K[0, 0] + K[0, 2], -1, width)).astype(np.int64)
    rows = np.floor(np.clip(y / depths * K[1, 1] + K[1, 2], -1, height)).astype(np.int64)
    inside = in_front & (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    shown = view.depth[np.where(inside, rows, 0), np.where(inside, columns, 0)]
    return z, np.where(inside, shown, 0).astype(np.float64)
