"""Axis-aligned boxes in world units, and the regions that a surface is reconstructed in.

A given box is neither shifted nor scaled. Without one, regions surround the points of the surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.scene.similarity import IDENTITY, Similarity

MIDDLE, MARGIN = 0.98, 0.1  # A robust box: share of the points along each axis; of its longest side, added all round.
CORE, CORE_MARGIN = 0.9, 0.25  # The same of a foreground that has a background: all of an even spread, no long tail.
BACKGROUND_FACTOR = 4.0  # Of the foreground's size: SuGaR's 1 E for the near part and 4 E for the far one.
REACH = 3.0  # Standard deviations of a Gaussian, within which it may make surface in a box.
FAR = 2.0  # Times the foreground's size that the points must reach for a background: two parts leave a seam.


def given_numbers(option: str, value: ArrayLike, count: int) -> np.ndarray:
    """`[count]` float64 numbers that an option was given.

    Raises:
        InputError: They are more or fewer, or no numbers.
    """
    try:
        numbers = np.asarray(value, np.float64).ravel()
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if len(numbers) != count:
        raise InputError(f"{option} {value}: expected {count} numbers")
    return numbers


@dataclass(frozen=True)
class Box:
    """The points p with low <= p <= high."""

    low: np.ndarray  # [3] float64 world, scene units
    high: np.ndarray  # [3]

    def __post_init__(self):
        """Check shapes and order."""
        for name in ("low", "high"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), np.float64))
        if self.low.shape != (3,) or self.high.shape != (3,) or not np.all(self.low < self.high):
            raise InputError(
                f"a box must have a min below its max along x, y and z, not {self.low.tolist()} and "
                f"{self.high.tolist()}"
            )

    def contains(self, points: np.ndarray) -> np.ndarray:
        """`[P]` bool for `[P, 3]` points."""
        return np.all((points >= self.low) & (points <= self.high), axis=1)

    def distances(self, points: np.ndarray) -> np.ndarray:
        """`[P]` distance of `[P, 3]` points from the box, scene units; 0 inside."""
        return np.linalg.norm(points - np.clip(points, self.low, self.high), axis=1)

    def grown(self, margin: float) -> "Box":
        """The box with every side moved outwards by `margin`, scene units; never shrunk to nothing."""
        middle, half = (self.low + self.high) / 2, (self.high - self.low) / 2
        half = np.maximum(half + margin, 1e-3 * half)
        return Box(middle - half, middle + half)

    def scaled(self, factor: float) -> "Box":
        """The box `factor` times as large about its own middle."""
        middle, half = (self.low + self.high) / 2, (self.high - self.low) / 2
        return Box(middle - factor * half, middle + factor * half)

    @property
    def longest(self) -> float:
        """Longest side, scene units."""
        return float(np.max(self.high - self.low))


@dataclass(frozen=True)
class Region:
    """A box, less another one inside it."""

    box: Box
    without: Box | None = None

    def contains(self, points: np.ndarray) -> np.ndarray:
        """`[P]` bool for `[P, 3]` points."""
        inside = self.box.contains(points)
        return inside if self.without is None else inside & ~self.without.contains(points)

    def grown(self, margin: float) -> "Region":
        """The region with a rim of `margin` scene units, also towards the box that it leaves out."""
        return Region(self.box.grown(margin), None if self.without is None else self.without.grown(-margin))

    def corners(self, similarity: Similarity = IDENTITY) -> list:
        """[low, high] of the box as plain numbers, in the world that `similarity` converts to these coordinates."""
        return similarity.points_to_world(np.stack([self.box.low, self.box.high])).tolist()


Regions = dict[str, Region]  # name -> where; "foreground" and "background"


def robust_box(points: np.ndarray, middle: float = MIDDLE, margin: float = MARGIN) -> Box:
    """The box of the middle share of `[P, 3]` points along every axis, grown by a share of its size on each side."""
    low, high = np.quantile(points, [(1 - middle) / 2, (1 + middle) / 2], axis=0)
    rim = margin * max((high - low).max(), 1e-6 * (1 + np.abs(points).max()))
    return Box(low - rim, high + rim)


def near_and_far(points: np.ndarray) -> Regions:
    """One robust box around the `[P, 3]` surface points (world), or two regions where they thin out far away.

    The foreground is then the box of the middle 90 %, half as large again, and the background the rest up to four times
    its size. One box with all of it is better where it is not even twice as large as that foreground.
    """
    core, whole = robust_box(points, CORE, CORE_MARGIN), robust_box(points)
    if whole.longest < FAR * core.longest:
        return {"foreground": Region(whole)}
    return fixed_boxes(core, core.scaled(BACKGROUND_FACTOR))


def fixed_boxes(foreground: Box, background: Box | None = None) -> Regions:
    """Boxes that the caller knows: the far part is what is in the second and not in the first."""
    return {"foreground": Region(foreground)} | (
        {} if background is None else {"background": Region(background, without=foreground)}
    )


@dataclass(frozen=True)
class Crop:
    """The boxes of the foreground and of the background."""

    boxes: tuple[Box, ...] = ()  # none: around the surface's points
    foreground_only: bool = False

    def to_local(self, similarity: Similarity) -> "Crop":
        """Return the same in local coordinates."""
        corners = (similarity.scale * (np.stack([box.low, box.high]) - similarity.center) for box in self.boxes)
        return replace(self, boxes=tuple(Box(low, high) for low, high in corners))

    def regions(self, points: np.ndarray) -> Regions:
        """Return the regions to reconstruct, from the `[P, 3]` points of the surface."""
        if self.boxes:
            return fixed_boxes(*self.boxes)
        regions = near_and_far(points)
        return {"foreground": regions["foreground"]} if self.foreground_only else regions

    def require_reached(self, gaussians: Gaussians, similarity: Similarity) -> None:
        """Check that a Gaussian reaches into a box; both are local, and `similarity` is of these coordinates.

        Raises:
            InputError: None does.
        """
        means = np.asarray(gaussians.means)
        reach = REACH * np.exp(np.asarray(gaussians.log_scales)).max(axis=1)
        if not self.boxes or any((box.distances(means) <= reach).any() for box in self.boxes):
            return
        low, high = (similarity.points_to_world(end(means, axis=0)).round(3).tolist() for end in (np.min, np.max))
        outer = self.boxes[-1]
        corners = similarity.points_to_world(np.stack([outer.low, outer.high])).round(3).tolist()
        raise InputError(
            f"bounds: the box {corners[0]} to {corners[1]} holds none of {len(means)} Gaussians, "
            f"which span {low} to {high}"
        )


def crop_of(bounds: Sequence[float] | None, background: Sequence[float] | None, foreground_only: bool) -> Crop:
    """Return the crop that options request, world coordinates.

    Args:
        bounds: x0 y0 z0 x1 y1 z1 of the foreground. None: around the points.
        background: The same of a background around `bounds`.
        foreground_only: No background is reconstructed.

    Raises:
        InputError: A box is not one, or there is a background alone.
    """
    if bounds is None:
        if background is not None:
            raise InputError("background_bounds needs bounds: the background is around that box")
        return Crop((), foreground_only)
    near = _given_box("bounds", bounds)
    far = None if background is None else _given_box("background_bounds", background)
    return Crop((near,) if foreground_only or far is None else (near, far), foreground_only)


def _given_box(option: str, corners: Sequence[float]) -> Box:
    sides = given_numbers(option, corners, 6)
    if not np.isfinite(sides).all():
        raise InputError(f"{option} {' '.join(f'{side:g}' for side in sides)}: not all of its sides are finite")
    return Box(sides[:3], sides[3:])
