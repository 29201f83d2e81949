"""Rendered depth where it is consistent with other views and with the photos: what one view alone shows is no surface.

Gaussians fit every photo, also with depth that is wrong: where nothing has texture, and where few photos look, each
view shows a surface of its own, and all of them together are lumps and shells. Photos compared with each other
(`gsjax.stereo`) have depth without Gaussians, but not everywhere.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from gsjax.gaussians import Gaussians
from gsjax.meshing import level_set
from gsjax.meshing.mesh_method import Method, SurfaceSamples
from gsjax.meshing.methods import DepthEvidence
from gsjax.rendering.coarse_depths import CoarseDepth, depths_at
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera, viewmat_center

AGREEING = 2  # Other views, at the least, that show a surface where a view shows it: one may be wrong as well.
SHARE = 0.7  # Of the views that observe the place, those that show it; the others see through it.
SAME_SURFACE = 0.01  # Share of the depth up to which two views show one surface,
PIXELS = 3.0  # or so many pixels of the other view in its place, where that is more: depths there are of pixels.
SAME_AS_STEREO = 0.02  # Share of the depth up to which a view shows what the stereo depth of its photo does.
FROM_ELSEWHERE = np.cos(np.radians(4.0))  # Cosine between two rays to a point: views nearer together are no evidence.
MOST_OTHERS = 16  # Views that are compared, those that observe most of what a view shows.
SAMPLED = 200  # Points of a view by which these are chosen.


def of_consistent_depth(method: Method, depths: DepthEvidence, ids: Sequence[int]) -> Method:
    """The method of `consistent_pictures`; `ids` are theirs, and the other arguments are of the `depths`."""

    def from_consistent_depth(
        gaussians: Gaussians, cameras: Sequence[Camera], pictures: Iterable[Picture]
    ) -> SurfaceSamples:
        shares: list[float] = []

        def counted() -> Iterator[Picture]:
            rendered, stereo, counts = depths.rendered, depths.stereo, depths.stereo_counts
            for picture in consistent_pictures(cameras, pictures, rendered, stereo, stereo_counts=counts, ids=ids):
                shares.append(float((picture.depth > 0).mean()))
                yield picture

        samples = method(gaussians, cameras, counted())
        of_depth = {"photos_that_tell": len(depths.stereo), "agreed_share": float(np.mean(shares))}
        return samples._replace(report=samples.report | of_depth)

    return from_consistent_depth


def consistent_pictures(
    cameras: Sequence[Camera],
    pictures: Iterable[Picture],
    rendered: Sequence[CoarseDepth],
    stereo: Mapping[int, np.ndarray],
    *,
    stereo_counts: bool,
    ids: Sequence[int] | None = None,
) -> Iterator[Picture]:
    """The same pictures, with depth where it is consistent and nothing elsewhere.

    Where a photo has stereo depth, the rendered depth is the same up to `SAME_AS_STEREO`. Elsewhere at least `AGREEING`
    other views, or all where they are fewer, and `SHARE` of those that nothing nearer hides the place from, show a
    surface there, up to `SAME_SURFACE` of the depth or `PIXELS`.

    Args:
        cameras: One camera a view.
        pictures: One rendered picture a camera, in order; read one by one.
        rendered: The coarse rendered depth of all views, which confirm each other.
        stereo: By the view's index in `rendered`, the stereo depth of its photo, `[h, w]` of any size; 0 where it has
            none.
        stereo_counts: Whether stereo depth counts where the rendered depth contradicts it, as for Gaussians that were
            trained without it; else neither counts.
        ids: Of every camera, its index in `rendered`. None: the cameras are those of all views.
    """
    compared = _others(rendered)
    ids = range(len(rendered)) if ids is None else ids
    for index, camera, picture in zip(ids, cameras, pictures, strict=True):
        level_set.check_sizes(index, camera, picture)
        is_shown = _enlarged(_agreed(rendered[index], [rendered[other] for other in compared[index]]), camera)
        depth, covered = np.asarray(picture.depth), np.asarray(picture.alphas)
        if index in stereo:
            by_photo = _enlarged(stereo[index], camera)
            is_same = np.abs(depth - by_photo) < SAME_AS_STEREO * by_photo
            is_shown = np.where(by_photo > 0, is_same, is_shown)
            if stereo_counts:
                replaced = (by_photo > 0) & ~is_same
                depth, is_shown = np.where(replaced, by_photo, depth), is_shown | replaced
                covered = np.where(replaced, np.float32(1), covered)
        yield picture._replace(depth=np.where(is_shown, depth, 0).astype(np.float32), alphas=covered)


def _agreed(view: CoarseDepth, others: Sequence[CoarseDepth]) -> np.ndarray:
    """`[H, W]` bool: where enough of the others show a surface at the place that the view shows."""
    rows, columns = np.nonzero(view.depth)
    points, rays = level_set.world_points(view.camera, view.depth, rows, columns)
    agreeing, observers = np.zeros((2, len(points)), np.int32)
    for other in others:
        depths, there = depths_at(points, other)
        towards = points - viewmat_center(np.asarray(other.camera.viewmat, np.float64))
        cosine = np.sum(rays * towards, axis=1) / np.maximum(np.linalg.norm(towards, axis=1), 1e-30)
        # From a view to which something nearer hides the place it may be there or not.
        same = max(SAME_SURFACE, PIXELS / float(other.camera.K[0, 0]))
        looks = (there > depths * (1 - same)) & (cosine < FROM_ELSEWHERE)
        observers += looks
        agreeing += looks & (there < depths * (1 + same))
    agreed = np.zeros(view.depth.shape, bool)
    agreed[rows, columns] = agreeing >= np.maximum(min(AGREEING, len(others)), SHARE * observers)
    return agreed


def _others(views: Sequence[CoarseDepth]) -> list[list[int]]:
    """Of every view the indices of those that observe most of what it shows, most first."""
    rng = np.random.default_rng(0)
    neighbors = []
    for index, view in enumerate(views):
        rows, columns = np.nonzero(view.depth)
        sample = rng.permutation(len(rows))[:SAMPLED]
        points, _ = level_set.world_points(view.camera, view.depth, rows[sample], columns[sample])
        common = np.array([(depths_at(points, other)[1] > 0).sum() for other in views], int)
        common[index] = 0
        best = np.argsort(-common, kind="stable")[:MOST_OTHERS]
        neighbors.append([int(other) for other in best if common[other] > 0])
    return neighbors


def _enlarged(values: np.ndarray, camera: Camera) -> np.ndarray:
    """Values of a coarse grid of a view at its pixels, each the nearest one: between two surfaces there is none."""
    rows, columns = (
        np.minimum(((np.arange(size) + 0.5) * side / size).astype(int), side - 1)
        for size, side in zip((camera.height, camera.width), values.shape, strict=True)
    )
    return values[np.ix_(rows, columns)]
