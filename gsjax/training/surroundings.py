"""Which Gaussians make the density about each: a table beside the Gaussians, made on the host every so many steps.

Only a run with a term that reads it has one.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

from gsjax.gaussians import Gaussians
from gsjax.nearest import nearest_table
from gsjax.settings import Phase
from gsjax.training.growth.adaptive import is_alive
from gsjax.training.state import TrainState
from gsjax.training.step import active_terms
from gsjax.training.terms.losses import NEEDS_SURROUNDINGS

NEAREST = 16  # Gaussians that the density at one is summed over, itself among them (SuGaR)
EVERY = 500  # steps between two tables (SuGaR)


def needed(phase: Phase) -> bool:
    """Whether a term of the phase reads the table."""
    return not NEEDS_SURROUNDINGS.isdisjoint(active_terms(phase.weights))


def none_yet(rows: int) -> np.ndarray:
    """`[rows, NEAREST]` int32 table in which every Gaussian is alone: its own id again stands for nobody."""
    return np.repeat(np.arange(rows, dtype=np.int32)[:, None], NEAREST, axis=1)


def found(gaussians: Gaussians) -> np.ndarray:
    """`[N, NEAREST]` int32 ids of the nearest living Gaussians by their centres, itself first; the dead are alone."""
    table = none_yet(gaussians.num_gaussians)
    alive = np.flatnonzero(np.asarray(is_alive(gaussians))).astype(np.int32)
    if len(alive):
        ids = alive[nearest_table(KDTree(np.asarray(gaussians.means, np.float64)[alive]), NEAREST)]
        table[alive, : ids.shape[1]] = ids
    return table


def refreshed(state: TrainState) -> TrainState:
    """The state with the table of its Gaussians as they are now."""
    return replace(state, nearest=jnp.asarray(found(state.gaussians)))
