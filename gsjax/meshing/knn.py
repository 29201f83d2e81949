"""Which points are nearest to each of many: a table of a fixed width, made on the host."""

import numpy as np
from scipy.spatial import KDTree

TREE_CHUNK = 262_144  # Queries at once.


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
