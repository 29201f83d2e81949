"""Which Gaussians make the density about each: a table that the terms on the density are refreshed with."""

import numpy as np
from scipy.spatial import KDTree

from gsjax.gaussians import Gaussians, is_alive
from gsjax.nearest import nearest_table

NEAREST = 16  # Gaussians that the density at one is summed over, itself among them (SuGaR)


def none_yet(rows: int) -> np.ndarray:
    """`[rows, NEAREST]` int32 table in which every Gaussian is alone: its own id again stands for nobody."""
    return np.repeat(np.arange(rows, dtype=np.int32)[:, None], NEAREST, axis=1)


def nearest(gaussians: Gaussians) -> np.ndarray:
    """`[N, NEAREST]` int32 ids of the nearest living Gaussians by their centres, itself first; the dead are alone."""
    table = none_yet(gaussians.num_gaussians)
    alive = np.flatnonzero(np.asarray(is_alive(gaussians))).astype(np.int32)
    if len(alive):
        ids = alive[nearest_table(KDTree(np.asarray(gaussians.means, np.float64)[alive]), NEAREST)]
        table[alive, : ids.shape[1]] = ids
    return table
