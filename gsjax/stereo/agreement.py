"""Depth that is more than chance: of pixels in patches, confirmed by another photo, right where points were matched."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from gsjax.stereo.views import Depth, View

SMALLEST_PATCH = 50  # pixels
SAME_PATCH = 0.01  # of the depth, between neighbouring pixels
CONFIRMED = 0.01  # of the depth, between what two photos say of a place
RIGHT = 0.03  # of the depth, from a matched point
FEWEST_RIGHT = 0.8  # share of the matched points, in a photo that is believed
FEWEST_TOLD = 20  # matched points from which that share is told


def patches(z: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """`[H, W]` bool: which of the counted pixels belong to a patch of like depth that is large enough."""
    number = np.arange(z.size).reshape(z.shape)
    logarithm = np.log(z)
    pairs = []
    for first, second in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        alike = counted[first] & counted[second] & (np.abs(logarithm[first] - logarithm[second]) < SAME_PATCH)
        pairs.append((number[first][alike], number[second][alike]))
    ends = tuple(np.concatenate(each) for each in zip(*pairs, strict=True))
    graph = coo_matrix((np.ones(len(ends[0]), bool), ends), shape=(z.size, z.size))
    label = connected_components(graph, directed=False)[1]
    return counted & (np.bincount(label)[label] >= SMALLEST_PATCH).reshape(z.shape)


def confirmed(view: View, depth: Depth, others: Sequence[tuple[View, Depth]]) -> np.ndarray:
    """`[H, W]` bool: pixels that are sure, of which another photo is sure too, and says the same."""
    points = view.lift(depth)
    agreed = np.zeros(len(points), bool)
    for other, said in others:
        row, column, z, inside = other.landing(points)
        shows = inside & said.is_sure[row, column]
        agreed |= shows & (np.abs(said.z[row, column] - z) < CONFIRMED * np.abs(z))
    counted = depth.is_sure.copy()
    counted[depth.is_sure] = agreed
    return patches(depth.z, counted)


class Evidence(NamedTuple):
    """Of the points that were matched in a photo where its depth is sure."""

    right: int
    told: int

    @property
    def is_good(self) -> bool:
        """Whether the photo's depth is to be believed; of a few points nothing is told."""
        return self.told < FEWEST_TOLD or self.right >= FEWEST_RIGHT * self.told


def evidence(view: View, depth: Depth, points: np.ndarray) -> Evidence:
    """What `[P, 3]` points, the scene's, say of a photo's depth."""
    row, column, z, inside = view.landing(points[view.matched])
    told = inside & depth.is_sure[row, column]
    right = told & (np.abs(depth.z[row, column] - z) < RIGHT * np.abs(z))
    return Evidence(int(right.sum()), int(told.sum()))
