"""Multi-view stereo depth of photos, where it is consistent between them, completed by planes; and points of it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from tqdm import tqdm

from gsjax.io.packages import MissingPackageError, require
from gsjax.io.parallel_map import parallel_map
from gsjax.scene import Scene
from gsjax.stereo.completion import complete
from gsjax.stereo.sweep import best_planes, dissimilarities, inverse_depths
from gsjax.stereo.views import MOST_VIEWS, View, neighbors, stereo_views

CONFIDENT = 0.6  # dissimilarity up to which a pixel may be confident
SMALLEST_PATCH = 50  # pixels
SAME_PATCH = 0.01  # of the depth, between neighbouring pixels
CONFIRMED = 0.01  # of the depth, between two photos that show one place
RIGHT = 0.03  # of the depth, from a matched point
FEWEST_RIGHT = 0.8  # share of the matched points, in a photo that is accepted
FEWEST_CHECKED = 20  # matched points, below which that share decides nothing
CANDIDATES = 20  # for every returned point, when they are thinned
GROWTH = 1.1  # of the cells that thin points, per round


class Evidence(NamedTuple):
    """Counts of the points that were matched in a photo where its depth is confident."""

    right: int
    checked: int

    @property
    def is_good(self) -> bool:
        """Whether the photo's depth is accepted; a few points decide nothing."""
        return self.checked < FEWEST_CHECKED or self.right >= FEWEST_RIGHT * self.checked


class PhotoDepth(NamedTuple):
    """Depth of one photo."""

    view: View
    depth: np.ndarray  # [H, W] float64 camera z, scene units; 0 where no other photo confirms it
    normals: np.ndarray  # [H, W, 3] float32 unit, in the camera's frame, towards it; 0 where depth is unknown
    evidence: Evidence  # of the photo's matched points


class PhotoDepths(NamedTuple):
    """Depth of photos."""

    accepted: tuple[PhotoDepth, ...]  # whose matched points confirm their depth
    compared: int  # how many photos were compared
    fault: str | None = None  # which package is missing, so that none was

    @property
    def line(self) -> str:
        """How many photos are accepted, and how right they are, in words."""
        right = sum(each.evidence.right for each in self.accepted)
        num_checked = sum(each.evidence.checked for each in self.accepted)
        share = (
            f"; {right / num_checked:.0%} of {num_checked:,} matched points confirm their depth" if num_checked else ""
        )
        return f"{len(self.accepted)} of {self.compared} photos{share}"


def depths_of_photos(scene: Scene, most: int = MOST_VIEWS) -> PhotoDepths:
    """Compute depth of training photos by multi-view stereo.

    A plane sweep compares every photo with its neighbours, and semi-global matching smooths the depth. A pixel counts
    where it is confident and another photo confirms it; a photo counts unless its own matched points contradict it.
    Planes of the photos' segments then complete the depth (`gsjax.stereo.completion`). Photos are compared at
    `gsjax.stereo.views.SIDE`.

    Args:
        scene: A loaded data set; without tracks no photo is compared.
        most: Photos that are compared; of more, some, evenly by name. Without OpenCV, none.

    Raises:
        InputError: The tracks cannot be read, or name points that the scene does not have.
    """
    try:
        require("cv2")
    except MissingPackageError as error:
        return PhotoDepths((), 0, str(error))
    views = stereo_views(scene, most)
    if len(views) < 2:
        return PhotoDepths((), len(views))
    compared = neighbors(views, scene.points)

    others_of = [[views[other] for other in each] for each in compared]
    photos = parallel_map(lambda index: _swept(views[index], others_of[index]), range(len(views)))
    swept = list(tqdm(photos, total=len(views), desc="stereo", unit="photo", leave=False))
    near = [
        sorted({*own, *(other for other, its in enumerate(compared) if index in its)})
        for index, own in enumerate(compared)
    ]
    own_depths = []
    for view, depth, others in zip(views, swept, near, strict=True):
        own = confirmed(view, depth, [(views[other], swept[other]) for other in others])
        # A photo that its points contradict has no say; what others show of its surface may complete it all the same.
        own_depths.append(own if evidence(view, own, scene.points).is_good else np.zeros_like(own))
    accepted = (
        PhotoDepth(view, *full, evidence(view, full.depth, scene.points))
        for view, full in zip(views, complete(views, own_depths, near), strict=True)
        if full.depth.any()
    )
    return PhotoDepths(tuple(accepted), len(views))


def _swept(view: View, others: list[View]) -> np.ndarray:
    if not others:
        return np.zeros(view.gray.shape)
    places, unlike = best_planes(dissimilarities(view, others))
    inverse = inverse_depths(view)
    return patches(np.where(unlike < CONFIDENT, 1 / (inverse[0] + places * (inverse[1] - inverse[0])), 0))


def patches(depth: np.ndarray) -> np.ndarray:
    """Return the depth `[H, W]` of the pixels that belong to a large enough patch of similar depth, else 0."""
    number, counted = np.arange(depth.size).reshape(depth.shape), depth > 0
    logarithm = np.log(np.where(counted, depth, 1))
    pairs = []
    for first, second in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        alike = counted[first] & counted[second] & (np.abs(logarithm[first] - logarithm[second]) < SAME_PATCH)
        pairs.append((number[first][alike], number[second][alike]))
    ends = tuple(np.concatenate(each) for each in zip(*pairs, strict=True))
    graph = coo_matrix((np.ones(len(ends[0]), bool), ends), shape=(depth.size,) * 2)
    label = connected_components(graph, directed=False)[1]
    return np.where((np.bincount(label)[label] >= SMALLEST_PATCH).reshape(depth.shape), depth, 0)


def confirmed(view: View, depth: np.ndarray, others: Sequence[tuple[View, np.ndarray]]) -> np.ndarray:
    """Return the depth `[H, W]` of the pixels that another photo shows at the same depth, else 0."""
    points = view.lift(depth)
    agreed = np.zeros(len(points), bool)
    for other, theirs in others:
        row, column, z, inside = other.landing(points)
        there = theirs[row, column]
        agreed |= inside & (there > 0) & (np.abs(there - z) < CONFIRMED * np.abs(z))
    own = np.zeros_like(depth)
    own[depth > 0] = np.where(agreed, depth[depth > 0], 0)
    return patches(own)


def evidence(view: View, depth: np.ndarray, points: np.ndarray) -> Evidence:
    """Compare a photo's depth with the scene's `[P, 3]` points that were matched in it."""
    row, column, z, inside = view.landing(points[view.matched])
    checked = inside & (depth[row, column] > 0)
    right = checked & (np.abs(depth[row, column] - z) < RIGHT * np.abs(z))
    return Evidence(int(right.sum()), int(checked.sum()))


class StereoPoints(NamedTuple):
    """Points on the surface, from which training starts."""

    points: np.ndarray  # [P, 3] float32 world
    colors: np.ndarray  # [P, 3] uint8
    line: str  # their number, in words


def stereo_points(swept: PhotoDepths, count: int) -> StereoPoints:
    """Return at most `count` points (1 at least) of the depth of one photo at least, evenly spread."""
    points = np.concatenate([each.view.lift(each.depth) for each in swept.accepted])
    colors = np.concatenate([each.view.color[each.depth > 0] for each in swept.accepted])
    indices = spread_evenly(points, count)
    line = f"{len(indices):,} more points of multi-view consistent depth"
    return StereoPoints(points[indices].astype(np.float32), colors[indices], line)


def spread_evenly(points: np.ndarray, count: int) -> np.ndarray:
    """Return indices of one point in every occupied cell, of cells so large that there are at most `count`."""
    some = np.arange(0, len(points), max(len(points) // (CANDIDATES * count), 1))
    from_low = (points - points.min(axis=0))[some]
    size = max(float(from_low.max()), 1e-30) / (2 * count)
    while True:
        x, y, z = np.floor(from_low / size).astype(np.int64).T
        _, first = np.unique((x * (y.max() + 1) + y) * (z.max() + 1) + z, return_index=True)
        if len(first) <= count:
            return some[np.sort(first)]
        size *= GROWTH
