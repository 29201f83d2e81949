"""The part of a scene that is meshed: boxes that are given, or regions around the points of the surface."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.meshing import regions
from gsjax.meshing.regions import Box, Regions
from gsjax.scene.similarity import Similarity

REACH = 3.0  # standard deviations of a Gaussian, within which it may make surface in a box


@dataclass(frozen=True)
class Crop:
    """The boxes of the foreground and of the background."""

    boxes: tuple[Box, ...] = ()  # none: around the surface's points
    foreground_only: bool = False

    def to_local(self, similarity: Similarity) -> "Crop":
        """Return the same in local coordinates."""
        return replace(self, boxes=tuple(regions.to_local(box, similarity) for box in self.boxes))

    def regions(self, points: np.ndarray) -> Regions:
        """Return the regions to reconstruct, from the `[P, 3]` points of the surface."""
        if self.boxes:
            return regions.fixed_boxes(*self.boxes)
        return regions.near_only(points) if self.foreground_only else regions.near_and_far(points)

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
            f"--bounds: the box {corners[0]} to {corners[1]} holds none of {len(means)} Gaussians, "
            f"which span {low} to {high}"
        )


def crop_of(bounds: Sequence[float] | None, background: Sequence[float] | None, foreground_only: bool) -> Crop:
    """Return the crop that options ask for, world coordinates.

    Args:
        bounds: x0 y0 z0 x1 y1 z1 of the foreground. None: around the points.
        background: The same of a background around `bounds`.
        foreground_only: No background is reconstructed.

    Raises:
        InputError: A box is not one, or there is a background alone.
    """
    if bounds is None:
        if background is not None:
            raise InputError("--background-bounds needs --bounds: the background is what lies around that box")
        return Crop((), foreground_only)
    near = _given_box("--bounds", bounds)
    far = None if background is None else _given_box("--background-bounds", background)
    return Crop((near,) if foreground_only or far is None else (near, far), foreground_only)


def _given_box(option: str, corners: Sequence[float]) -> Box:
    sides = regions.given_numbers(option, corners, 6)
    if not np.isfinite(sides).all():
        raise InputError(f"{option} {' '.join(f'{side:g}' for side in sides)}: not all of its sides are finite")
    return Box(sides[:3], sides[3:])
