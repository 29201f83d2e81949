"""Points where photos agree about depth, for training to start with."""

from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from gsjax.scene import Scene
from gsjax.stereo.aggregation import best_planes
from gsjax.stereo.agreement import Evidence, confirmed, evidence, patches
from gsjax.stereo.sweep import dissimilarities, inverse_depths
from gsjax.stereo.views import Depth, View, neighbors, stereo_views

SURE = 0.6  # dissimilarity up to which a pixel may be sure
CANDIDATES = 20  # for every point that is to stay, when they are thinned
GROWTH = 1.1  # of the cells by which points are thinned, per trial


class StereoPoints(NamedTuple):
    """What was found."""

    points: np.ndarray  # [P, 3] float32 world
    colors: np.ndarray  # [P, 3] uint8
    line: str  # how much, and how right it is


def stereo_points(scene: Scene, count: int) -> StereoPoints | None:
    """At most `count` points on what training photos show alike, evenly spread; None where they show nothing alike.

    Every photo is swept by planes against its neighbours, smoothed, and kept where it is sure, where another photo
    confirms it, and unless its own matched points contradict it. Photos are compared at `gsjax.stereo.views.SIDE`.

    Args:
        scene: A loaded data set; without tracks nothing is found.
        count: At least 1.

    Raises:
        InputError: The tracks cannot be read, or name points that the scene does not have.
    """
    views = stereo_views(scene)
    if len(views) < 2:
        return None
    near = neighbors(views, scene.points)
    swept = [
        _swept(view, [views[other] for other in others])
        for view, others in zip(tqdm(views, desc="stereo", unit="photo", leave=False), near, strict=True)
    ]
    found, told = [], []
    for index, (view, depth) in enumerate(zip(views, swept, strict=True)):
        others = sorted({*near[index], *(other for other, its in enumerate(near) if index in its)})
        sure = confirmed(view, depth, [(views[other], swept[other]) for other in others])
        kept = depth._replace(is_sure=sure)
        said = evidence(view, kept, scene.points)
        if said.is_good and kept.is_sure.any():
            found.append((view.lift(kept), view.color[kept.is_sure]))
            told.append(said)
    if not found:
        return None
    points, colors = (np.concatenate(each) for each in zip(*found, strict=True))
    chosen = spread_evenly(points, count)
    return StereoPoints(points[chosen].astype(np.float32), colors[chosen], _line(len(chosen), len(views), told))


def _swept(view: View, others: list[View]) -> Depth:
    if not others:
        return Depth(np.ones(view.gray.shape), np.zeros(view.gray.shape, bool))
    places, unlike = best_planes(dissimilarities(view, others))
    inverse = inverse_depths(view)
    z = 1 / (inverse[0] + places * (inverse[1] - inverse[0]))
    return Depth(z, patches(z, unlike < SURE))


def spread_evenly(points: np.ndarray, count: int) -> np.ndarray:
    """Indices of one point in every occupied cell, of cells so large that there are at most `count`."""
    some = np.arange(0, len(points), max(len(points) // (CANDIDATES * count), 1))
    from_low = (points - points.min(axis=0))[some]
    size = max(float(from_low.max()), 1e-30) / (2 * count)
    while True:
        x, y, z = np.floor(from_low / size).astype(np.int64).T
        _, first = np.unique((x * (y.max() + 1) + y) * (z.max() + 1) + z, return_index=True)
        if len(first) <= count:
            return some[np.sort(first)]
        size *= GROWTH


def _line(count: int, photos: int, told: list[Evidence]) -> str:
    right, known = (sum(each) for each in zip(*told, strict=True))
    share = f"; {right / known:.0%} of {known:,} matched points confirm their depth" if known else ""
    return f"{count:,} more points where photos agree about depth ({len(told)} of {photos} photos{share})"
