"""Buffers that grow and shrink with the Gaussians: a step costs what is alive, not what the budget allows.

Every per-Gaussian array has free rows. It is lengthened before a densification would run out of them, and shortened
after the last densification and after a cull. A buffer of the whole budget gives the same bits, and is slower.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from gsjax.gaussians import DEAD_LOGIT, is_alive
from gsjax.settings import Density
from gsjax.training.densification.rules import DensificationRule
from gsjax.training.optimizers import Optimizer
from gsjax.training.state import TrainState
from rasterizer.engines import resolve

# Rows below which another compilation costs more than it saves; a GPU hardly feels so many more.
FEWEST_ROWS = 1 << 15
FEWEST_ROWS_OF_KERNELS = 1 << 18
ROUND = 1024  # rows that shortened buffers are multiples of
WORTH = 7 / 8  # of the rows: buffers that would not be shorter than that stay, for another length is a compilation


def _fewest_rows() -> int:
    return FEWEST_ROWS_OF_KERNELS if resolve("auto") == "pallas" else FEWEST_ROWS


def bucket(count: int, most: int) -> int:
    """Rows for `count` Gaussians: the budget `most`, halved as often as leaves room for them and for the fewest."""
    rows, least = most, max(count, _fewest_rows())
    while rows // 2 >= least:
        rows //= 2
    return rows


def _fitting(count: int, most: int) -> int:
    """Rows for `count` Gaussians that are not to multiply."""
    return min(max(-(-count // ROUND) * ROUND, _fewest_rows()), most)


def lengthen(state: TrainState, optimizer: Optimizer, rows: int) -> TrainState:
    """The same state in longer buffers; the new rows are free. With no more rows than now, the state itself."""
    extra = rows - state.gaussians.num_gaussians
    if extra <= 0:
        return state

    def zeros_after(array: Array) -> Array:
        return jnp.concatenate([array, jnp.zeros((extra, *array.shape[1:]), array.dtype)])

    gaussians = jax.tree.map(zeros_after, state.gaussians)
    return replace(
        state,
        gaussians=replace(
            gaussians,
            quats=gaussians.quats.at[-extra:, 0].set(1.0),
            logit_opacities=gaussians.logit_opacities.at[-extra:].set(DEAD_LOGIT),
        ),
        opt_state=optax.tree.map_params(optimizer, zeros_after, state.opt_state),
        statistics=jax.tree.map(zeros_after, state.statistics),
    )


def shorten(state: TrainState, optimizer: Optimizer, most: int) -> TrainState:
    """The living Gaussians in their order, in buffers that are no longer than they have to be.

    Where that saves little, the state itself.
    """
    alive = np.asarray(is_alive(state.gaussians))
    rows = _fitting(int(alive.sum()), most)
    if rows > WORTH * len(alive):
        return state
    indices = np.argsort(~alive, kind="stable")[:rows]

    def of_kept(array: Array) -> Array:
        return array[indices]

    return replace(
        state,
        gaussians=jax.tree.map(of_kept, state.gaussians),
        opt_state=optax.tree.map_params(optimizer, of_kept, state.opt_state),
        statistics=jax.tree.map(of_kept, state.statistics),
    )


@partial(jax.jit, static_argnames=("rule", "density", "budget"))
def _next_count(state: TrainState, *, rule: DensificationRule, density: Density, budget: int) -> Array:
    return rule.wanted_count(state.gaussians, state.statistics, density, step=state.step, budget=budget)


def with_room_to_densify(
    state: TrainState, optimizer: Optimizer, density: Density, most: int, *, rule: DensificationRule
) -> TrainState:
    """The state in buffers that hold what the next densification makes of it, as far as `most` Gaussians allow."""
    rows = state.gaussians.num_gaussians
    if rows >= most:
        return state
    count = int(_next_count(state, rule=rule, density=density, budget=most))
    return state if count <= rows else lengthen(state, optimizer, bucket(count, most))
