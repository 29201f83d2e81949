"""Densification of 3DGS at a fixed capacity, under jit: clone, split, prune, reset, cull; and when.

A row of the buffers is dead when its log-odds of opacity are at `DEAD_LOGIT`: it draws nothing, has no gradient, and is
free for a new Gaussian. When more Gaussians want to grow than rows are free, the largest gradients win.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax import Array

from gsjax.gaussians import DEAD_LOGIT, Gaussians, is_alive, opacities, rotation_matrices, scales, take
from gsjax.settings import Density

DENSE_SHARE = 0.01  # of the extent: larger Gaussians split, smaller ones are cloned (3DGS, percent_dense)
GRADIENT = 2e-4  # mean norm of the loss' gradient to the 2D mean, NDC units, from which Gaussians are densified (3DGS)
MIN_OPACITY = 0.005  # under which Gaussians are pruned (3DGS, train.py)
MAX_SHARE = 0.1  # of the extent: larger ones are pruned, by `error_driven` the near ones (3DGS)
SPLIT = 1.6  # Times smaller than the whole are the halves of a split (3DGS: 0.8 times two).
RESET_OPACITY = 0.01  # to which opacities are capped (3DGS)
LARGE_SHARE = 0.2  # Of `density.stop`: where nothing resets opacities, size prunes after it. 3DGS: 3,000 of 15,000.


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GradientStatistics:
    """Sums since the last densification, which decide what is cloned or split."""

    gradient: Array  # [N] norms of the loss' gradient to the 2D mean, NDC units
    views: Array  # [N] times visible


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Moves:
    """How the rows of every per-Gaussian array move: row i comes from `source[i]`, with fresh state where `fresh`."""

    source: Array  # [N] int32
    fresh: Array  # [N] bool


def densifies(density: Density, step: int) -> bool:
    """Whether Gaussians are cloned, split and pruned after this step."""
    return density.start < step < density.stop and step % density.every == 0


def prunes_large(density: Density, step: int) -> bool:
    """Whether size prunes after this step: past the first reset of the opacities (3DGS).

    Without resets, past a fifth of the steps up to `stop`.
    """
    return step > (density.reset_every or LARGE_SHARE * density.stop)


def resets_opacities(density: Density, step: int, background: str) -> bool:
    """Whether opacities are reset after this step: every `reset_every` steps; never where that is 0.

    Over a white background at `start` too (3DGS: what was fitted to the white goes before anything grows).
    """
    if density.reset_every == 0 or step >= density.stop:
        return False
    return step % density.reset_every == 0 or (background == "white" and step == density.start)


def empty_statistics(capacity: int) -> GradientStatistics:
    """Zero sums."""
    return GradientStatistics(jnp.zeros(capacity, jnp.float32), jnp.zeros(capacity, jnp.float32))


def accumulate(
    statistics: GradientStatistics, means2d_gradient: Array, visible: Array, distances: Array, size: Array
) -> GradientStatistics:
    """Add one view: `means2d_gradient` `[N, 2]` in 1 / pixels becomes NDC units (times half the photo's `[2]` size)."""
    del distances
    ndc = means2d_gradient * (0.5 * size.astype(jnp.float32))[None]
    norm = jnp.sqrt(jnp.sum(ndc * ndc, -1))
    return GradientStatistics(
        statistics.gradient + jnp.where(visible, norm, 0), statistics.views + visible.astype(jnp.float32)
    )


def wanted_count(
    gaussians: Gaussians, statistics: GradientStatistics, density: Density, *, step: Array, budget: int
) -> Array:
    """`[]` int32 Gaussians that the densification after this step requests; within the budget it gets them."""
    del step, budget
    alive = is_alive(gaussians)
    grows = alive & (_mean_gradient(statistics) >= GRADIENT)
    return jnp.sum(alive, dtype=jnp.int32) + jnp.sum(grows, dtype=jnp.int32)


def _mean_gradient(statistics: GradientStatistics) -> Array:
    return statistics.gradient / jnp.maximum(statistics.views, 1)


def densify(
    gaussians: Gaussians,
    statistics: GradientStatistics,
    key: Array,
    *,
    density: Density,
    extent: float | Array,
    prune_large: Array | bool,
    count: Array | None = None,
) -> tuple[Gaussians, Moves]:
    """Clone, split and prune.

    A Gaussian whose mean gradient reaches `GRADIENT` is cloned when small (the copy starts with zero moments)
    and split when large (two samples of itself, 1.6 times smaller, both with zero moments). Pruned is what then is
    under `MIN_OPACITY` and, if `prune_large`, larger than `MAX_SHARE` of the extent: a large, badly
    fitted Gaussian leaves its halves behind where these are small enough. Where rows are short it waits, whole.

    Gradients decide which Gaussians multiply, and free rows how many: `count` is not used. `extent` is that of the
    cameras, scene units. Whether size prunes (`prune_large`) may be traced.

    Returns:
        The Gaussians and how rows moved, for the optimiser's moments.
    """
    del count
    largest, gradient = scales(gaussians).max(-1), _mean_gradient(statistics)
    is_opaque = is_alive(gaussians) & (opacities(gaussians) >= MIN_OPACITY)
    wants = is_opaque & (gradient >= GRADIENT)
    splits = largest > DENSE_SHARE * extent
    # Growing changes no opacity and a size by a known factor. So what pruning would take afterwards, children and all,
    # is known now, and its row serves at once.
    to_be = jnp.where(wants & splits, largest / SPLIT, largest)
    stays = is_opaque & ~(jnp.asarray(prune_large) & (to_be > MAX_SHARE * extent))
    grows = stays & wants
    growers = jnp.argsort(jnp.where(grows, -gradient, jnp.inf)).astype(jnp.int32)
    source, is_child, is_parent = assign_rows(growers, stays, jnp.minimum(jnp.sum(~stays), jnp.sum(grows)))
    moved = take(kill(gaussians, ~stays), source)
    is_half = splits[source] & (is_child | is_parent)
    densified = _with_samples(moved, is_half, key)
    return densified, Moves(source, is_child | is_half | ~is_alive(densified))


def assign_rows(growers: Array, stays: Array, count: Array) -> tuple[Array, Array, Array]:
    """Give the first `count` of the rows `growers` `[N]` a second row each, of those that do not stay.

    Growing rows are in their order, the others in that of index: the j-th of one takes the j-th of the other.

    Returns:
        `[N]` int32 rows that each row comes from; `[N]` bool, whether it is a second row, and whether it has one.
    """
    turn = jnp.arange(len(stays), dtype=jnp.int32)
    free_rows = jnp.argsort(stays, stable=True).astype(jnp.int32)
    target = jnp.where(turn < count, free_rows, len(stays))
    source = turn.at[target].set(growers, mode="drop")
    return source, mark(free_rows, count), mark(growers, count)


def mark(rows: Array, count: Array) -> Array:
    """`[N]` bool: the first `count` of `rows`, `[N]`."""
    is_marked = jnp.arange(len(rows), dtype=jnp.int32) < count
    return jnp.zeros(len(rows), bool).at[jnp.where(is_marked, rows, len(rows))].set(True, mode="drop")


def _with_samples(gaussians: Gaussians, is_half: Array, key: Array) -> Gaussians:
    """The Gaussians, halves `[N]` at samples of themselves and `SPLIT` times smaller."""
    offset = jnp.sum(
        rotation_matrices(gaussians.quats)
        * (scales(gaussians) * jax.random.normal(key, gaussians.means.shape, jnp.float32))[:, None, :],
        axis=-1,
    )
    smaller = gaussians.log_scales - jnp.log(jnp.float32(SPLIT))
    return replace(
        gaussians,
        means=jnp.where(is_half[:, None], gaussians.means + offset, gaussians.means),
        log_scales=jnp.where(is_half[:, None], smaller, gaussians.log_scales),
    )


def kill(gaussians: Gaussians, mask: Array) -> Gaussians:
    """Kill the Gaussians of `mask`, `[N]` bool."""
    return replace(gaussians, logit_opacities=jnp.where(mask, DEAD_LOGIT, gaussians.logit_opacities))
