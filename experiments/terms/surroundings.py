"""Which Gaussians make the density about each: a table on the host, made anew every 500 steps (SuGaR)."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial import KDTree

from gsjax.gaussians import Gaussians, is_alive
from gsjax.meshing.neighborhood import nearest_table
from gsjax.rendering import View
from gsjax.scene.batches import Batch

NEAREST = 16  # Gaussians that the density at one is summed over, itself among them (SuGaR)
REFRESHED_EVERY = 500  # looks at a table before the next is made (SuGaR)


class Around(NamedTuple):
    """What a term reads besides view and batch."""

    table: Array  # [N, NEAREST] int32, see `nearest`
    key: Array  # of this step: two steps draw differently
    extent: float  # camera extent, scene units


class Surroundings:
    """The neighbours of the Gaussians of one run.

    A step reads them through a callback, so no checkpoint has a table: a resumed run begins with a new one.
    """

    def __init__(self, extent: Callable[[], float]):
        """No table yet; `extent` returns that of the cameras, scene units."""
        self._extent, self._looks = extent, 0
        self._alive, self._table = np.empty(0, bool), np.empty((0, NEAREST), np.int32)

    def shown_to(self, loss: Callable[..., Array]) -> Callable[[Gaussians, View, Batch], Array]:
        """The term of a loss that reads an `Around` as well."""

        def term(gaussians: Gaussians, view: View, batch: Batch) -> Array:
            means, alive = jax.lax.stop_gradient(gaussians.means), is_alive(gaussians)
            shape = jax.ShapeDtypeStruct((gaussians.num_gaussians, NEAREST), jnp.int32)
            table = jax.pure_callback(self.look, shape, means, alive)
            # Every step moves the means, so their bits make its key.
            bits = jax.lax.bitcast_convert_type(jnp.sum(means, dtype=jnp.float32), jnp.uint32)
            return loss(gaussians, view, batch, Around(table, jax.random.key(bits), self._extent()))

        return term

    def look(self, means: Array, alive: Array) -> np.ndarray:
        """The table; another where other rows are alive, and after `REFRESHED_EVERY` looks."""
        rows = np.asarray(alive)
        if self._looks % REFRESHED_EVERY == 0 or not np.array_equal(rows, self._alive):
            self._alive, self._table, self._looks = rows.copy(), nearest(np.asarray(means), rows), 0
        self._looks += 1
        return self._table


def none_yet(rows: int) -> np.ndarray:
    """`[rows, NEAREST]` int32 table in which every Gaussian is alone: its own id again means no neighbour."""
    return np.repeat(np.arange(rows, dtype=np.int32)[:, None], NEAREST, axis=1)


def nearest(means: np.ndarray, alive: np.ndarray) -> np.ndarray:
    """`[N, NEAREST]` int32 ids of the nearest living Gaussians by their centres, itself first; the dead are alone."""
    table = none_yet(len(means))
    living = np.flatnonzero(alive).astype(np.int32)
    if len(living):
        ids = living[nearest_table(KDTree(means[living].astype(np.float64)), NEAREST)]
        table[living, : ids.shape[1]] = ids
    return table
