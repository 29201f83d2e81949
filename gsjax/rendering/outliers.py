"""Gaussians that are no part of a scene: giants, isolated small clusters, and floaters.

A floater is in front of the surface that other views show. Training makes some where one photo gains and no other photo
disagrees; the views decide (`are_floaters`). Giants and isolated clusters are judged without views.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from gsjax.gaussians import Gaussians, covariances
from gsjax.rendering.coarse_depths import SAME_SURFACE, CoarseDepth, depths_at
from gsjax.scene.cameras import Camera, viewmat_centers

NEIGHBORS = 12  # of a Gaussian that it may hang on
SPACING = 3  # The distance to so many-th of them is how close Gaussians are to each other there,
REACH = 2.5  # and so many times that far apart, two Gaussians hang together.
SMALL = 0.002  # of all Gaussians: a cluster of fewer is small
FEWEST = 8  # Of a small scene too, fewer make no thing.
WIDE = 0.4  # of its distance from the nearest camera: a Gaussian of a larger deviation fills the picture
WIDE_ALONE = 0.5  # of the size of the whole, where no camera is known
CONVERGING = 0.9  # of the cameras must see the point that they look at
SUPPORTING = 2  # Views that show a Gaussian where it is: fewer do not tell how far away it is.
LOOKING_THROUGH = 2  # Views that show what is behind a Gaussian: one may be wrong.
NEAR = 0.3  # Of the median depth of a view: nearer than that, what this view alone shows hangs before its camera.
DEVIATIONS = 3.0  # A Gaussian reaches so many of its standard deviations towards a camera, and away from it.


def cluster_sizes(means: np.ndarray) -> np.ndarray:
    """`[N]` how many Gaussians hang together with each, itself included.

    Two hang together where they are among each other's nearest and no farther apart than a few times the spacing around
    either of them; a dense object and a sparse background may be apart, and both be large. Means are finite.
    """
    count = len(means)
    if count <= SPACING:
        return np.full(count, count)
    distances, others = map(np.asarray, KDTree(means).query(means, k=min(NEIGHBORS + 1, count)))
    reach = REACH * distances[:, SPACING]
    rows = np.repeat(np.arange(count), others.shape[1])
    columns, apart = others.ravel(), distances.ravel()
    near = apart <= np.minimum(reach[rows], reach[columns])
    graph = coo_matrix((near[near], (rows[near], columns[near])), shape=(count, count))
    _, labels = connected_components(graph, directed=False)
    return np.bincount(labels)[labels]


def most_of_small(count: int) -> int:
    """How many Gaussians a small cluster has at most, in a scene of `count`."""
    return max(FEWEST, math.floor(SMALL * count))


def giants(means: np.ndarray, scales: np.ndarray, centers: np.ndarray | None) -> np.ndarray:
    """`[N]` bool: which Gaussians, of `[N, 3]` means and standard deviations, are so large that they can show nothing.

    The measure is how near the cameras come, whose centres are `[V, 3]`; without any, the size of the whole.
    """
    largest = scales.max(axis=1)
    if centers is None:
        middle = np.median(means, axis=0)
        return largest > WIDE_ALONE * np.quantile(np.linalg.norm(means - middle, axis=1), 0.9)
    nearest, _ = KDTree(centers).query(means)
    return largest > WIDE * nearest


def looked_at(cameras: Sequence[Camera]) -> tuple[np.ndarray, float] | None:
    """The sphere that cameras surround: the point nearest to all their axes, and their median distance from it.

    Returns:
        Its middle `[3]` and radius; None where fewer than nine in ten cameras have that point in front of them.
    """
    viewmats = np.stack([np.asarray(camera.viewmat, np.float64) for camera in cameras])
    centers, axes = viewmat_centers(viewmats), viewmats[:, 2, :3]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    middle = np.linalg.lstsq(across.sum(0), np.einsum("vij,vj->i", across, centers), rcond=None)[0]
    ahead = np.einsum("vi,vi->v", middle - centers, axes)
    if (ahead > 0).mean() < CONVERGING:
        return None
    return middle, float(np.median(np.linalg.norm(centers - middle, axis=1)))


def are_floaters(gaussians: Gaussians, views: Iterable[CoarseDepth]) -> np.ndarray:
    """Which Gaussians hang in the air.

    A view *supports* a Gaussian if the depth that it shows at the Gaussian's mean is the Gaussian's own, up to
    `SAME_SURFACE` of it and `DEVIATIONS`; it *looks through* the Gaussian if that depth is greater. A floater has fewer
    than `SUPPORTING` views, and either `LOOKING_THROUGH` and more that look through it, or one that has it nearer than
    `NEAR` of the median depth that it shows. What is hidden behind a surface, or not finite, is none.

    Views have the depths that these Gaussians show, and are read one by one. Returns `[N]` bool, numpy.
    """
    means, shapes = np.asarray(gaussians.means, np.float64), np.asarray(covariances(gaussians), np.float64)
    usable = np.isfinite(means).all(axis=1) & np.isfinite(shapes).all(axis=(1, 2))
    means, shapes = means[usable], shapes[usable]
    supporting, through = np.zeros((2, len(means)), np.int32)
    hangs_near = np.zeros(len(means), bool)
    for view in views:
        if not view.depth.any():
            continue
        forward = np.asarray(view.camera.viewmat, np.float64)[2, :3]
        depths, surface_depths = depths_at(means, view)
        thickness = np.sqrt(np.maximum(shapes @ forward @ forward, 0))
        margin = SAME_SURFACE * surface_depths + DEVIATIONS * thickness
        supports = (surface_depths > 0) & (np.abs(depths - surface_depths) <= margin)
        supporting += supports
        through += (surface_depths > 0) & (depths < surface_depths - margin)
        hangs_near |= supports & (depths < NEAR * np.median(view.depth[view.depth > 0]))
    is_floater = np.zeros(len(usable), bool)
    is_floater[usable] = (supporting < SUPPORTING) & ((through >= LOOKING_THROUGH) | hangs_near)
    return is_floater
