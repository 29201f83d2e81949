"""A large scene in blocks: cells of the ground between cameras, and the photos that each of them needs.

Cells are cut where cameras are: in halves of as many cameras, across the longer side, again and again. They fill all
of space, as the outer ones have no end, so that every Gaussian is one block's and no other's.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gsjax.errors import InputError

MARGIN = 0.15  # of a cell's side, as far as cameras are there: cameras so far beyond the border belong to it too
LEAST_SHARE_SEEN = 0.3  # of what a photo sees: such a cell is trained with it, wherever its camera is
FEWEST = 4  # photos that are trained on in a block


@dataclass(frozen=True)
class Cell:
    """A part of space between planes, across two directions."""

    low: tuple[float, float] = (-math.inf, -math.inf)  # world units along the directions
    high: tuple[float, float] = (math.inf, math.inf)

    def holds(self, places: np.ndarray) -> np.ndarray:
        """`[N]` bool, whether `[N, 2]` places along the directions are in it; a border is the upper cell's."""
        return np.logical_and.reduce((places >= self.low) & (places < self.high), axis=1)

    def grown(self, places: np.ndarray) -> "Cell":
        """The cell with the margin that belongs to a block, by the `[N, 2]` places of its cameras."""
        own = places[self.holds(places)]
        beyond = MARGIN * (own.max(axis=0) - own.min(axis=0))
        low, high = (np.array(self.low) - beyond).tolist(), (np.array(self.high) + beyond).tolist()
        return Cell((low[0], low[1]), (high[0], high[1]))


def directions(centers: np.ndarray) -> np.ndarray:
    """`[2, 3]` unit vectors along which `[V, 3]` cameras are spread most, the widest first."""
    return np.linalg.svd(centers - centers.mean(0), full_matrices=False)[2][:2]


def cut(places: np.ndarray, count: int) -> list[Cell]:
    """So many cells with as many cameras each, as nearly as may be, by `[V, 2]` places along the directions.

    Raises:
        InputError: There are not so many places.
    """
    apart = len(np.unique(places, axis=0))
    if apart < count:
        raise InputError(f"blocks={count}: the cameras are at {apart} places")
    return _cut(places, count, Cell())


def _cut(places: np.ndarray, count: int, cell: Cell) -> list[Cell]:
    if count == 1:
        return [cell]
    axis = int(np.argmax(places.max(axis=0) - places.min(axis=0)))
    along = np.sort(places[:, axis])
    first = count // 2
    before = max(1, min(len(along) - 1, round(len(along) * first / count)))
    border = float(along[before - 1] + along[before]) / 2
    lower, upper = list(cell.high), list(cell.low)
    lower[axis] = upper[axis] = border
    is_lower = places[:, axis] < border
    return [
        *_cut(places[is_lower], first, replace(cell, high=(lower[0], lower[1]))),
        *_cut(places[~is_lower], count - first, replace(cell, low=(upper[0], upper[1]))),
    ]


def photos_of(cell: Cell, places: np.ndarray, points_of_photos: Sequence[np.ndarray]) -> np.ndarray:
    """`[V]` bool: the photos that a block is trained on, by `[V, 2]` places of cameras and `[P_v, 2]` of points."""
    sees = [len(points) > 0 and float(cell.holds(points).mean()) >= LEAST_SHARE_SEEN for points in points_of_photos]
    return cell.grown(places).holds(places) | np.array(sees)
