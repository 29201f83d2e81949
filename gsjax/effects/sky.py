"""Where photos show open sky: regions that may be one, and whether their light comes from infinity.

A region may be sky where it is even, above the horizon, open to the photo's upper border and without a matched point,
in several photos that look the same way. A plain ceiling is all of that. So a sky is only reported where its light
depends on the direction alone (`gsjax.effects.parallax`): to take a surface away is worse than to leave a sky.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from gsjax.effects.kinds import EffectKind, Evidence, Findings, Masks, unknown
from gsjax.effects.observations import EVEN, UNUSABLE, Observations, block_means, even_stride, light_stride, upwards
from gsjax.effects.parallax import Parallax
from gsjax.scene import Frame
from gsjax.scene.cameras import landing

THRESHOLD = 1.2  # times the error at infinity, which any other place of the light has at least
LARGE_ROOM = 2 / 3  # of that threshold, for rooms far larger than what was matched: a sky is hardly different from them
BLUE, BLUE_RANGE, BLUE_BONUS = 0.5, 0.3, 1.25  # EV of green over red; EV that it changes by; times the score,
UNDECIDED = 1.05  # which must be this much without: that of an even colour is 1 within some hundredths
VIVID, VIVID_RANGE = 0.7, 0.4  # EV, of a blue that no plaster has: that of painted rooms changes by 0.1
SHARE = 0.25  # of the photos
FEWEST = 2  # photos
OPEN = 0.05  # of a photo's pixels, and
OPEN_BORDER = 0.4  # of its upper border, in the photos that say that there is a sky;
LEAST = 0.003  # of a photo's pixels, of any region of the sky once there is one
UPPER = 0.15  # of the elevations that a photo spans: the upper border is what is so near to its highest
BELOW = (-5.0, 0.05)  # degrees of elevation, and the share of a region that may be lower
POINTS = (0.05, 10.0)  # of the points that a region so large would have, that a sky has at most; fewest of the latter
ALIKE = 0.3  # of a region, which another photo has as sky in the same directions
CELLS = 10  # to the unit, by which directions are compared: 6 degrees
MOST_INSIDE = 0.5  # of the photos that have a point in view, beyond which it is in their sky


def find(observations: Observations) -> Masks:
    """Where the photos may show sky, or plaster; empty where they show neither, or cameras or points do not show it."""
    up = upwards(observations.frames)
    if up is None or not len(observations.points) or any(facts.has_matte for facts in observations.facts):
        return {}
    views = [
        _view(frame, facts.even, observations.points, up)
        for frame, facts in zip(observations.frames, observations.facts, strict=True)
    ]
    typical = float(np.median([view.points.sum() / max(view.usable.sum(), 1) for view in views]))
    candidates = [_regions(view, typical) for view in views]
    pairs = [(view, regions) for view, regions in zip(views, candidates, strict=True) if regions]
    cells = [np.unique(view.cells[np.logical_or.reduce(regions)]) for view, regions in pairs]
    cells, counts = np.unique(np.concatenate([*cells, np.empty(0, int)]), return_counts=True)
    masks, strong = {}, 0
    for frame, view, regions in zip(observations.frames, views, candidates, strict=True):
        shared = np.isin(view.cells, cells[counts >= FEWEST])
        shared_regions = [region for region in regions if shared[region].mean() >= ALIKE]
        if shared_regions:
            masks[frame.name] = _full_size(np.logical_or.reduce(shared_regions), frame)
            strong += any(_is_plain(region, view) for region in shared_regions)
    return masks if strong >= max(FEWEST, SHARE * len(views)) else {}


def judge(findings: Findings) -> Evidence:
    """Judge whether the regions that the diagnosis has found are sky."""
    return judge_masks(findings.observations, findings.masks, findings.of_masks)


def judge_masks(observations: Observations, masks: Masks, compared: Parallax | None = None) -> Evidence:
    """Judge whether the regions of `find` are sky; on only where their light comes from infinity.

    `compared` is what `gsjax.effects.parallax.compare` measured in `regions`.
    """
    unit = "times the error at infinity"
    if any(facts.has_matte for facts in observations.facts):
        return Evidence(False, 0.0, unit, 0.0, THRESHOLD, "mattes separate the object from what is behind it")
    if not observations.tracked:
        return unknown(unit, THRESHOLD, "without tracks a sky is no different from a wall")
    if upwards(observations.frames) is None:
        return unknown(unit, THRESHOLD, "the cameras' upward axes are inconsistent")
    if not masks or compared is None:
        note = "no sky" if not masks else f"no sky: {PLAIN}; even or clipped in all photos, so nothing compares"
        return Evidence(False, 0.0, unit, 1.0, THRESHOLD, note)
    value = score(compared)
    note = summary(masks, observations.frames) if value > THRESHOLD else f"no sky: {PLAIN}"
    note += f"; at a near surface x{compared.near:.2f}, a far one x{compared.far:.2f}, fixed to the photo"
    note += f" x{compared.fixed:.2f}; green over red {compared.blueness:.2f} EV, changing by {compared.blue_range:.2f}"
    # The pictures of validation runs do not show the gain, that Gaussians near the surface paint no sky.
    return Evidence(value > THRESHOLD, value, unit, 1.0, THRESHOLD, note, is_certain=True)


PLAIN = "a ceiling, a wall or a sky that looks like one"


def score(compared: Parallax) -> float:
    """How many times worse than infinity the likeliest surface explains the photos; a blue that changes adds to it.

    Photos of nearly one place hardly distinguish infinity from a far wall: there a vivid blue that no near wall
    explains better is enough.
    """
    is_blue = compared.blueness > BLUE and compared.blue_range > BLUE_RANGE
    likeliest = min(compared.near, compared.fixed)
    if compared.blueness > VIVID and compared.blue_range > VIVID_RANGE and likeliest >= 1:
        return BLUE_BONUS * likeliest
    bonus = BLUE_BONUS if is_blue and likeliest > UNDECIDED else 1.0
    return min(bonus * likeliest, compared.far / LARGE_ROOM)


def regions(observations: Observations, masks: Masks) -> dict[int, np.ndarray]:
    """Index of a photo -> `[h, w]` bool on the grid of `PhotoFacts.light`: places that are in its mask as a whole."""
    return {
        index: block_means(masks[frame.name], light_stride(frame.width, frame.height)) == 1
        for index, frame in enumerate(observations.frames)
        if frame.name in masks
    }


def summary(masks: Masks, frames: Sequence[Frame]) -> str:
    """One line: how many photos show sky, and how much of it."""
    if not masks:
        return "no sky"
    share = np.mean([mask.mean() for mask in masks.values()])
    return f"sky in {len(masks)} of {len(frames)} photos, {100 * share:.0f} % of their pixels"


def tinted(image: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    """`[H, W, 3]` uint8 photo with its sky in magenta, half transparent; `mask` `[H, W]` bool, None: no sky."""
    if mask is None:
        return image
    return np.where(mask[..., None], image // 2 + np.array([127, 0, 127], np.uint8), image)


def lies_in(points: np.ndarray, frames: Sequence[Frame], masks: Masks) -> np.ndarray:
    """`[N]` bool: which points `[N, 3]` most of the photos that have them in view show sky at, two at least.

    Nothing is on the ray of a sky's pixel, so that a point of a surface is in no photo's sky; most must confirm
    because a mask may be wrong. A point that is not finite is in none.
    """
    finite = np.logical_and.reduce(np.isfinite(points), axis=1)
    usable = np.where(finite[:, None], points, 0).astype(np.float64)
    viewed, inside = np.zeros((2, len(points)), int)
    for frame in frames:
        at = landing(usable, frame.viewmat, frame.K, (frame.height, frame.width))
        viewed += at.inside
        if frame.name in masks:
            inside += at.inside & masks[frame.name][at.rows, at.columns]
    return finite & (inside >= FEWEST) & (inside > MOST_INSIDE * viewed)


class _View(NamedTuple):
    """A photo on its coarse grid, each `[h, w]`."""

    even: np.ndarray  # bool
    usable: np.ndarray  # bool
    points: np.ndarray  # how many of the scene's points land there
    elevation: np.ndarray  # degrees above the horizon
    cells: np.ndarray  # int, of directions
    border: np.ndarray  # bool, the upper border of what is usable


def _view(frame: Frame, even: np.ndarray, points: np.ndarray, up: np.ndarray) -> _View:
    (height, width), stride = even.shape, even_stride(frame.width, frame.height)
    at = landing(points, frame.viewmat, frame.K, (frame.height, frame.width))
    rows, columns = np.minimum(at.rows // stride, height - 1), np.minimum(at.columns // stride, width - 1)
    counts = np.zeros(even.shape)
    np.add.at(counts, (rows[at.inside], columns[at.inside]), 1)
    K = frame.K.astype(np.float64)
    x, y = np.meshgrid((np.arange(width) + 0.5) * stride, (np.arange(height) + 0.5) * stride)
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], -1)
    rays = rays @ frame.viewmat[:3, :3].astype(np.float64) / np.linalg.norm(rays, axis=-1, keepdims=True)
    elevation = np.degrees(np.arcsin(np.clip(rays @ up, -1, 1)))
    cells = np.rint(CELLS * rays).astype(np.int64) @ np.array([1, 100, 10_000])
    usable = even != UNUSABLE
    border = usable & np.logical_not(ndimage.binary_erosion(usable))
    if border.any():
        highest, lowest = elevation[usable].max(), elevation[usable].min()
        border &= elevation > highest - UPPER * (highest - lowest)
    return _View(even == EVEN, usable, counts, elevation, cells, border)


def _regions(view: _View, typical: float) -> list[np.ndarray]:
    """`[h, w]` bool each: connected even regions that may be sky. `typical` is of points to a place of the grid."""
    labels, _ = ndimage.label(view.even)  # pyright: ignore[reportGeneralTypeIssues]
    dense = max(typical, view.points.sum() / max(view.usable.sum(), 1))
    sizes, candidates = np.bincount(labels.ravel()), []
    for label in np.unique(labels[view.border & view.even]):
        region = labels == label
        expected = dense * sizes[label]
        is_above = (view.elevation[region] < BELOW[0]).mean() <= BELOW[1]
        is_bare = view.points[region].sum() <= POINTS[0] * expected
        is_told = expected >= POINTS[1] or sizes[label] < OPEN * view.usable.sum()
        if sizes[label] >= LEAST * view.usable.sum() and is_above and is_bare and is_told:
            candidates.append(region)
    return candidates


def _is_plain(region: np.ndarray, view: _View) -> bool:
    """Whether a region alone implies that there is a sky."""
    return region.sum() >= OPEN * view.usable.sum() and region[view.border].mean() >= OPEN_BORDER


def _full_size(coarse: np.ndarray, frame: Frame) -> np.ndarray:
    stride = even_stride(frame.width, frame.height)
    whole = coarse.repeat(stride, 0).repeat(stride, 1)
    missing = [(0, frame.height - whole.shape[0]), (0, frame.width - whole.shape[1])]
    return np.pad(whole, missing, mode="edge")


EFFECT = EffectKind(judge, uncovers="background", masked_terms="sky")
