"""Which vertices of a reconstruction are supported by the points, and which are guesses that must go.

A Poisson surface is always closed: where there are no points it invents a membrane. Two things tell a guess: how far
the vertex is from every point, and how few points the reconstruction's own density saw around it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

THINNEST_SUPPORTED = 0.005  # The quantile of the supported vertices' densities that counts as their lower end.


@dataclass(frozen=True)
class Support:
    """V vertices of a reconstruction, and what the points say about them."""

    distances: np.ndarray  # [V] to the nearest point, scene units
    densities: np.ndarray  # [V] of points around, any increasing measure
    edges: np.ndarray  # [E, 2] vertex ids
    near: float  # scene units: vertices up to here are supported
    far: float  # scene units: vertices beyond are guesses


class Cut(NamedTuple):
    """What to take away."""

    vertices: np.ndarray  # [V] bool
    quantile: float  # share of the vertices that go for their density alone


Trim = Callable[[Support], Cut]


def adaptive(support: Support) -> Cut:
    """Cuts what is far from every point, and what is too thin and leads there.

    Too thin is a vertex that is not near a point and below the lower end of the densities of those that are: no number
    is chosen by hand. A thin patch with support all around bridges a small hole, and stays.
    """
    is_near, is_far = support.distances <= support.near, support.distances > support.far
    if not is_near.any():
        return Cut(is_far, 0.0)
    too_thin = ~is_near & (support.densities < np.quantile(support.densities[is_near], THINNEST_SUPPORTED))
    unsound = is_far | too_thin
    patch = _patches(unsound, support.edges)
    leads_far = np.zeros(len(unsound), bool)
    leads_far[patch[is_far]] = True
    cut = unsound & leads_far[patch]
    return Cut(cut, float((cut & ~is_far).mean()))


def _patches(members: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """`[V]` a label per vertex, the same for members that are connected through members."""
    inner = edges[members[edges].all(axis=1)]
    graph = coo_matrix((np.ones(len(inner), bool), (inner[:, 0], inner[:, 1])), shape=(len(members),) * 2)
    return connected_components(graph, directed=False)[1]


def at_quantile(quantile: float) -> Trim:
    """Cuts what is far from every point, and the given share of the vertices, the least dense ones (SuGaR: 0.1)."""

    def trim(support: Support) -> Cut:
        thin = support.densities < np.quantile(support.densities, quantile)
        return Cut(thin | (support.distances > support.far), quantile)

    return trim
