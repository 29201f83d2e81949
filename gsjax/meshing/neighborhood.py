"""Which Gaussians make the density around a ray: the one that was hit, near ones, and large ones that reach there."""

import numpy as np
from scipy.spatial import KDTree

from gsjax import gaussians as gs
from gsjax.gaussians import Gaussians
from gsjax.meshing import density_field

LARGE_SHARE = 0.25  # Of the places for neighbours: those kept for what is large.
CANDIDATES = 2  # Of each size, for each of those places.
REACH = 3.0  # Standard deviations beyond which a Gaussian makes no density to speak of.
SMALLEST = 1e-8  # Standard deviations under this are of one size, scene units.
ROWS_CHUNK = 32_768  # Rows of the table at once.
TREE_CHUNK = 262_144  # Queries of the tree at once.


class Neighborhood:
    """Lists of a fixed length, made once for each Gaussian and looked up for each ray."""

    def __init__(self, gaussians: Gaussians, neighbors: int):
        centers = np.asarray(gaussians.means, np.float64)
        self._tree = KDTree(centers)
        self._table = nearest_table(self._tree, neighbors)
        large = int(LARGE_SHARE * self._table.shape[1])
        if large:
            self._table[:, -large:] = _with_large(gaussians, self._tree, self._table, large)

    def of(self, hits: np.ndarray, owners: np.ndarray) -> np.ndarray:
        """`[R, k]` ids for rays that hit the Gaussians `owners` `[R]` at the points `hits` `[R, 3]`: owners first."""
        ids = self._table[np.asarray(self._tree.query(hits, 1, workers=-1)[1])]
        return with_first(ids, owners.astype(ids.dtype))


def _with_large(gaussians: Gaussians, tree: KDTree, table: np.ndarray, large: int) -> np.ndarray:
    """`[N, large]` ids: the last of each row of the table, or what makes more density at its centre from farther off.

    Sought among Gaussians of one size at a time: of a kind as large as the gap to it there are few around a point.
    """
    deviations = np.asarray(gs.scales(gaussians)).max(axis=1)
    octaves = np.floor(np.log2(np.maximum(deviations, SMALLEST)))
    neighbors = np.empty((len(table), large), np.int32)
    sizes = [np.flatnonzero(octaves == octave) for octave in np.unique(octaves)]
    trees = [(members, KDTree(tree.data[members]), REACH * deviations[members].max()) for members in sizes]
    # What takes an offset to units of each Gaussian's standard deviations, `[N, 3, 3]`.
    whitening = np.asarray(density_field.kernels(gaussians).whitening)

    def distances(centers: np.ndarray, ids: np.ndarray) -> np.ndarray:
        offsets = centers[:, None] - tree.data[ids]
        return np.linalg.norm(np.einsum("nkij,nkj->nki", whitening[ids], offsets), axis=-1)

    for start in range(0, len(table), ROWS_CHUNK):
        part = slice(start, start + ROWS_CHUNK)
        centers, nearest = tree.data[part], table[part]
        ids = nearest[:, -large:]
        apart = distances(centers, ids)
        for members, of_size, reach in trees:
            positions = np.asarray(
                of_size.query(centers, CANDIDATES * large, distance_upper_bound=reach, workers=-1)[1]
            )
            positions = positions.reshape(len(centers), -1)
            new = members[np.minimum(positions, len(members) - 1)]
            off = distances(centers, new)
            is_new = (positions < len(members)) & (off < REACH) & ~(new[:, :, None] == nearest[:, None, :]).any(-1)
            ids, apart = np.c_[ids, new], np.c_[apart, np.where(is_new, off, np.inf)]
            best = np.argsort(apart, axis=1, kind="stable")[:, :large]
            ids, apart = np.take_along_axis(ids, best, 1), np.take_along_axis(apart, best, 1)
        neighbors[part] = ids
    return neighbors


def nearest_table(tree: KDTree, count: int) -> np.ndarray:
    """`[N, k]` int32 ids of the nearest of every point of the tree, itself first; found in chunks.

    k is `count`, or N where there are fewer points.
    """
    points = tree.data
    count = min(count, len(points))
    table = np.empty((len(points), count), np.int32)
    for start in range(0, len(points), TREE_CHUNK):
        part = slice(start, start + TREE_CHUNK)
        table[part] = np.asarray(tree.query(points[part], count, workers=-1)[1]).reshape(-1, count)
    return with_first(table, np.arange(len(points), dtype=np.int32))


def with_first(table: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Every row with its `own` id in the first place, in exchange for another or, were it absent, for the last."""
    table = table.copy()
    is_own = table == own[:, None]
    place = np.where(is_own.any(1), is_own.argmax(1), table.shape[1] - 1)
    rows = np.arange(len(table))
    table[rows, place] = table[:, 0]
    table[:, 0] = own
    return table
