"""Multi-view consistency of the normal maps of several photos.

A network sees one photo at a time, so its errors differ from photo to photo, and the truth does not. Poses and depth
are known, so every pixel of a map projects into neighbouring photos, whose maps have a normal for the same place. All
arrays are numpy's, at a working size of about ten thousand pixels a view.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from gsjax.scene.cameras import landing, thinned_K, viewmat_center

LONGEST = 128  # pixels of a view's longer side at the working size
NEIGHBORS = 6  # views that each is compared with
WIDEST = 70.0  # degrees between two rays to a place, beyond which views overlap too little
GOOD_ANGLE = 25.0  # degrees between the rays, from which on two views differ enough
LEAST_ANGLE = 10.0  # degrees, under which a map that only faces its camera is consistent too
SAME_DEPTH = 0.02  # relative difference of depth up to which two pixels show the same place
FULL_WEIGHT, ZERO_WEIGHT = 15.0, 25.0  # degrees of error: up to one a normal has weight 1, from the other on weight 0
LEAST_EVIDENCE = 0.1  # of a photo and of a whole set of maps
OWN_VOTE = 0.5  # weight of a pixel's own normal, of its neighbours' 1
FEWEST = 100  # pairs of pixels that the evidence of a photo needs
FEWEST_PHOTOS = 3  # with evidence, that a verdict needs

_PROBES = 300  # pixels of a view by which its neighbours are chosen
_ROUNDS = 6  # of the geometric median
_SMOOTH = 0.04  # of the longer side: deviation of the window from which unobserved pixels take their weight


class View(NamedTuple):
    """One photo's map at the working size."""

    normals: np.ndarray  # [h, w, 3] float32 unit, camera frame, zero where there is none
    depth: np.ndarray  # [h, w] float32 camera z, zero where it is not known
    viewmat: np.ndarray  # [4, 4] world to camera
    K: np.ndarray  # [3, 3] pixels of the working size, centres at +0.5


class PhotoEvidence(NamedTuple):
    """How consistent one photo's map is with its neighbours'."""

    confidence: np.ndarray  # [h, w] float32 in 0..1, zero where there is no normal
    mean_confidence: float  # over the pixels that have a normal; 0 where there is none
    evidence: float | None  # 1 - (median disagreement / that of a map which only faces its camera); None: unknown
    noise: float | None  # of the evidence, from one neighbour to the next
    apart: float | None  # median degrees between its normals and theirs; None: unknown


class Verdict(NamedTuple):
    """The decision on a whole set of maps."""

    is_accepted: bool
    evidence: float | None  # median of the photos'; None: cannot be judged
    noise: float | None  # of that median
    threshold: float  # `evidence` minus `noise` of an accepted set is above it
    share: float  # mean confidence after the verdict, over all pixels that have a normal
    rejected: tuple[int, ...]  # photos that are left out whole
    note: str


def thinned_view(normals: np.ndarray, depth: np.ndarray, viewmat: np.ndarray, K: np.ndarray) -> View:
    """Return a `View` of every n-th pixel of a map `[H, W, 3]`, of any length but zero, and of its depth `[H, W]`."""
    stride = stride_of(depth.shape)
    first = stride // 2
    small = normals[first::stride, first::stride].astype(np.float32)
    length = np.linalg.norm(small, axis=-1, keepdims=True)
    small = np.where(length > 0, small / np.where(length > 0, length, 1), 0)
    return View(small, depth[first::stride, first::stride].astype(np.float32), viewmat, thinned_K(K, stride))


def stride_of(shape: Sequence[int]) -> int:
    """Return the n of `thinned_view` for a view `[H, W]`."""
    return max(1, -(-max(shape[:2]) // LONGEST))


def judge_maps(
    views: Sequence[View], *, progress: Callable[[Iterable[int]], Iterable[int]] = iter
) -> tuple[list[PhotoEvidence], Verdict]:
    """Compare every view of a set of maps with its neighbours; `progress` wraps the photos' numbers, for a bar.

    Returns:
        One `PhotoEvidence` a photo, with confidence zero for rejected photos and sets; and the `Verdict`.
    """
    points = [_world_points(view) for view in views]
    neighbors = _neighbors(views, points)
    photos = [_photo_evidence(index, views, points, neighbors[index]) for index in progress(range(len(views)))]
    verdict = _verdict(photos, views)
    for index in verdict.rejected if verdict.is_accepted else range(len(views)):
        zero = np.zeros_like(photos[index].confidence)
        photos[index] = photos[index]._replace(confidence=zero, mean_confidence=0.0)
    return photos, verdict


def share_compared(apart: float | None) -> float:
    """Return the share of steps in which the loss compares a photo with a neighbour, by `apart` of its evidence.

    Terms that compare photos make a consistent surface flat and cost no PSNR. On an inconsistent one, such as a bare
    wall, they do (experiments/results/price_on_photos.md). The angle decides, not the evidence: between photos that
    are side by side even a flat floor has none. The share is 1 up to `FULL_WEIGHT` degrees and where they are
    unknown, and 0 from `ZERO_WEIGHT` degrees on.
    """
    return 1.0 if apart is None else float(np.clip((ZERO_WEIGHT - apart) / (ZERO_WEIGHT - FULL_WEIGHT), 0, 1))


def full_size(confidence: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return a confidence `[h, w]` of the working size at that of the whole map, `[H, W]`."""
    stride = stride_of(shape)
    sides = zip(shape, confidence.shape, strict=True)
    return confidence[np.ix_(*(np.minimum(np.arange(side) // stride, small - 1) for side, small in sides))]


def _world_points(view: View) -> np.ndarray:
    """Return `[h, w, 3]` float64 world positions of the pixels."""
    height, width = view.depth.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([(x - view.K[0, 2]) / view.K[0, 0], (y - view.K[1, 2]) / view.K[1, 1], np.ones_like(x)], -1)
    return (rays * view.depth[..., None] - view.viewmat[:3, 3]) @ view.viewmat[:3, :3]


def _landing(points: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project world points `[..., 3]`: row and column `[...]` of their pixels, and whether those show the points."""
    row, column, z, inside = landing(points, view.viewmat, view.K, view.depth.shape)
    there = view.depth[row, column]
    return row, column, inside & (there > 0) & (np.abs(there - z) < SAME_DEPTH * z)


def _degrees_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """`[...]` degrees between unit vectors `[..., 3]`."""
    return np.degrees(np.arccos(np.clip(np.sum(a * b, axis=-1), -1, 1)))


def _towards(view: View, points: np.ndarray) -> np.ndarray:
    """`[..., 3]` unit directions from points `[..., 3]` to a view's camera."""
    away = viewmat_center(view.viewmat) - points
    return away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-12)


def _neighbors(views: Sequence[View], points: Sequence[np.ndarray]) -> list[list[int]]:
    """Return for every view the others that show most of it from a direction that differs enough."""
    rng = np.random.default_rng(0)
    neighbors = []
    for index, view in enumerate(views):
        observed = points[index][(view.depth > 0) & np.any(view.normals, axis=-1)]
        probes = observed[rng.permutation(len(observed))[:_PROBES]]
        scores = np.zeros(len(views))
        for other, there in enumerate(views):
            if other == index or not len(probes):
                continue
            visible = _landing(probes, there)[2]
            angles = _degrees_between(_towards(view, probes), _towards(there, probes))[visible]
            scores[other] = np.sum(np.where(angles < WIDEST, np.minimum(angles / GOOD_ANGLE, 1), 0)) / len(probes)
        best = np.argsort(-scores, kind="stable")[:NEIGHBORS]
        neighbors.append([int(other) for other in best if scores[other] > 0])
    return neighbors


def _photo_evidence(
    index: int, views: Sequence[View], points: Sequence[np.ndarray], neighbors: Sequence[int]
) -> PhotoEvidence:
    view = views[index]
    has_normal = np.any(view.normals, axis=-1)
    has_depth = has_normal & (view.depth > 0)
    place = points[index][has_depth]
    own = (view.normals @ view.viewmat[:3, :3])[has_depth]
    others, visible_in, apart, chance = [], [], [], []
    for other in neighbors:
        there = views[other]
        row, column, visible = _landing(place, there)
        normals = (there.normals @ there.viewmat[:3, :3])[row, column]
        others.append(normals)
        visible_in.append(visible & np.any(normals, axis=-1))
        apart.append(_degrees_between(own, normals))
        chance.append(_degrees_between(_towards(view, place), _towards(there, place)))
    if not others or not np.any(visible_in):
        return PhotoEvidence(has_normal.astype(np.float32), float(has_normal.any()), None, None, None)
    others, visible_in, apart, chance = map(np.stack, (others, visible_in, apart, chance))
    error = np.full(has_normal.shape, np.nan)
    error[has_depth] = _error(own, others, visible_in, apart)
    confidence = _filled(np.clip((ZERO_WEIGHT - error) / (ZERO_WEIGHT - FULL_WEIGHT), 0, 1)) * has_normal
    mean = float(confidence[has_normal].mean()) if has_normal.any() else 0.0
    return PhotoEvidence(confidence.astype(np.float32), mean, *_agreement(apart, chance, visible_in))


def _error(own: np.ndarray, others: np.ndarray, visible: np.ndarray, apart: np.ndarray) -> np.ndarray:
    """Estimate `[P]` degrees of error of a pixel's normal; NaN where no neighbour shows it.

    The larger of two estimates for independent errors: the angle to the geometric median of the neighbours' normals
    and, with `OWN_VOTE`, its own; and the (lower) median angle to one neighbour, over the root of two, as both may be
    wrong. The first alone would accept a map that only faces its camera, where cameras are around the place.

    `own` are `[P, 3]` world normals of the pixels, `others` `[M, P, 3]` those of the neighbours at the same places, and
    `apart` `[M, P]` degrees between the two.
    """
    observed = visible.any(axis=0)
    votes = np.concatenate([visible, np.full((1, len(own)), OWN_VOTE)])
    middle = _geometric_median(np.concatenate([others, own[None]]), votes)
    ranked = np.sort(np.where(visible, apart, np.inf), axis=0)
    lower_median = np.take_along_axis(ranked, np.maximum((visible.sum(axis=0) - 1) // 2, 0)[None], axis=0)[0]
    error = np.maximum(_degrees_between(own, middle), lower_median / np.sqrt(2))
    return np.where(observed, error, np.nan)


def _geometric_median(directions: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Return `[P, 3]` unit vectors of the least weighted (`[M, P]`) sum of distances to `[M, P, 3]` (Weiszfeld)."""
    weights = counted
    for _ in range(_ROUNDS):
        middle = np.sum(weights[..., None] * directions, axis=0)
        middle /= np.maximum(np.linalg.norm(middle, axis=-1, keepdims=True), 1e-12)
        weights = counted / np.maximum(np.linalg.norm(directions - middle, axis=-1), 0.02)
    return middle


def _agreement(
    apart: np.ndarray, chance: np.ndarray, visible: np.ndarray
) -> tuple[float | None, float | None, float | None]:
    """Return `evidence`, `noise` and `apart` of a photo: its consistency, compared with maps that only face cameras.

    The degrees `[M, P]` are those between the normals of two views, and between the directions to their cameras.
    """
    counted = visible & (chance > LEAST_ANGLE)
    if counted.sum() < FEWEST:
        return None, None, None
    each = [
        1 - np.median(a[t]) / np.median(c[t]) for a, c, t in zip(apart, chance, counted, strict=True) if t.sum() > 9
    ]
    noise = float(np.std(each) / np.sqrt(len(each))) if len(each) > 1 else 1.0
    middle = float(np.median(apart[counted]))
    return float(1 - middle / np.median(chance[counted])), noise, middle


def _filled(confidence: np.ndarray) -> np.ndarray:
    """Replace NaN in `[h, w]` by the values around it, and by the photo's mean where none is near."""
    observed = np.isfinite(confidence)
    if not observed.any():
        return np.ones_like(confidence)
    values = np.where(observed, confidence, 0)
    width = _SMOOTH * max(confidence.shape)
    weight = ndimage.gaussian_filter(observed.astype(np.float64), width)
    around = (ndimage.gaussian_filter(values, width) + 0.01 * values.sum() / observed.sum()) / (weight + 0.01)
    return np.where(observed, values, around)


def _verdict(photos: Sequence[PhotoEvidence], views: Sequence[View]) -> Verdict:
    photo_values = [
        (index, photo.evidence, photo.noise or 0.0) for index, photo in enumerate(photos) if photo.evidence is not None
    ]
    areas = np.array([float(np.any(view.normals, axis=-1).sum()) for view in views])
    means = np.array([photo.mean_confidence for photo in photos])
    empty = int((areas == 0).sum())
    lacks = empty >= max(len(views) / 2, 1)
    lacking = f", {empty} of {len(views)} have no normals" if empty else ""
    lacking += " (fewer than half may lack them)" if lacks else ""
    if len(photo_values) < FEWEST_PHOTOS:
        why = f"cannot be judged: {len(photo_values)} photos show enough of others from another direction{lacking}"
        return Verdict(not lacks, None, None, LEAST_EVIDENCE, 0.0 if lacks else _share(means, areas), (), why)
    values = np.array([evidence for _, evidence, _ in photo_values])
    middle = float(np.median(values))
    noise = float(1.4826 * np.median(np.abs(values - middle)) / np.sqrt(len(values)))
    rejected = tuple(index for index, evidence, off in photo_values if evidence + off < LEAST_EVIDENCE)
    is_accepted = middle - noise > LEAST_EVIDENCE and not lacks
    means[list(rejected)] = 0
    share = _share(means, areas) if is_accepted else 0.0
    note = f"{len(rejected)} of {len(photo_values)} photos rejected{lacking}"
    return Verdict(is_accepted, middle, noise, LEAST_EVIDENCE, share, rejected, note)


def _share(means: np.ndarray, areas: np.ndarray) -> float:
    return float(np.sum(means * areas) / max(float(areas.sum()), 1.0))
