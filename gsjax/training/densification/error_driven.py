"""Error-driven densification: the budget goes where the pictures are wrong, and comes from what they hardly show.

A Gaussian answers for its share of every pixel's error: sum over pixels of blending weight times error (Rota Bulo,
Porzi, Kontschieder: Revising Densification in Gaussian Splatting). The largest shares split, so many that the budget is
full on time; and in every densification some of the least seen make room for more, so that a full one keeps moving.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gsjax.gaussians import Gaussians, is_alive, opacities, rotation_matrices, scales, take
from gsjax.numerics import mean_channel
from gsjax.rendering import View
from gsjax.scene.batches import Batch
from gsjax.settings import Density
from gsjax.training.densification.gradient_driven import MAX_SHARE, MIN_OPACITY, Moves, assign_rows, kill, mark

SHORTER = 0.6  # A half's deviation along the axis that splits, in those of the whole; the others stay.
APART = (1 - SHORTER**2) ** 0.5  # And how far off it sits: both halves together spread as the whole did.
OVERLAP = np.exp(-((APART / SHORTER) ** 2)) / np.sqrt(2)  # Integral of the halves' product over that of one of them.


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ErrorStatistics:
    """What decides who splits and who goes, summed over the views since the last densification."""

    error: Array  # [N] pixels, see `accumulate`: blending weight times mean absolute difference to the photo
    weight: Array  # [N] pixels: blending weight
    views: Array  # [N] times it showed
    depths: Array  # [N] camera extents: depths in the views where it showed


def empty_statistics(capacity: int) -> ErrorStatistics:
    """Zero sums."""
    return ErrorStatistics(*(jnp.zeros(capacity, jnp.float32) for _ in range(4)))


def probe_loss(view: View, batch: Batch) -> Array:
    """`[]` zero, whose gradient to two channels of zeros is what each Gaussian has of the error and of the photo."""
    assert view.probes is not None, "the probe is rendered as two channels of zeros"
    error = mean_channel(jnp.abs(view.colors - batch.image))
    channels = jnp.stack([error, jnp.ones_like(error)], -1) * batch.valid[..., None].astype(jnp.float32)
    return jnp.sum(jax.lax.stop_gradient(channels) * view.probes)


def accumulate(
    statistics: ErrorStatistics, shares: Array, visible: Array, distances: Array, size: Array
) -> ErrorStatistics:
    """Add one view: the `[N, 2]` gradient of `probe_loss`, less of what is nearer than a camera extent.

    There the pixels of one photo are so many that whatever floats before it would outbid all that others see as well:
    they count by the area that they cover in the scene (as gradients do in Pixel-GS, Zhang et al. 2024).
    """
    del size
    shares = shares * jnp.square(jnp.minimum(distances, 1))[:, None]
    return ErrorStatistics(
        statistics.error + shares[:, 0],
        statistics.weight + shares[:, 1],
        statistics.views + visible.astype(jnp.float32),
        statistics.depths + jnp.where(visible, distances, 0),
    )


def wanted_count(
    gaussians: Gaussians, statistics: ErrorStatistics, density: Density, *, step: Array, budget: int
) -> Array:
    """`[]` int32 Gaussians after the densification of this step, on the way to the whole budget.

    The same factor in every densification fills it at `density.full_by` of the steps from `start` to `stop`. A scene
    that starts with few points and one that starts with many are both on time, and what dies is made up for.
    """
    del statistics
    last = int(density.start + density.full_by * (density.stop - density.start)) // density.every
    left = jnp.maximum(last - step // density.every + 1, 1)  # densifications until then, this one included
    alive = jnp.sum(is_alive(gaussians).astype(jnp.float32))
    factor = (budget / jnp.maximum(alive, 1)) ** (1 / left.astype(jnp.float32))
    return jnp.where(left == 1, budget, jnp.minimum(jnp.ceil(alive * factor).astype(jnp.int32), budget))


def densify(
    gaussians: Gaussians,
    statistics: ErrorStatistics,
    key: Array,
    *,
    density: Density,
    extent: float | Array,
    prune_large: Array | bool,
    count: Array,
) -> tuple[Gaussians, Moves]:
    """Drop the faint and the oversized, split those that answer for most of the error, the largest shares first.

    So many split that there are `count` (`[]` int32, see `wanted_count`), and `density.replace` of it more: for these
    the least seen make room. Nothing is drawn with the key. Otherwise as `gradient_driven.densify`; both halves of a
    split start with no moments.
    """
    del key
    # What floats before the cameras must be small; what is far behind may be few, and then each is large.
    away = jnp.maximum(statistics.depths / jnp.maximum(statistics.views, 1), 1)
    too_large = scales(gaussians).max(-1) > MAX_SHARE * extent * jnp.square(away)
    stays = is_alive(gaussians) & (opacities(gaussians) >= MIN_OPACITY)
    stays &= ~(jnp.asarray(prune_large) & too_large)
    splitting = _ranked(stays & (statistics.error > 0), -statistics.error)
    stays, births = _make_room(stays, splitting, statistics, jnp.minimum(count, len(stays)), density.replace)
    source, is_child, is_parent = assign_rows(splitting, stays, births)
    moved = take(kill(gaussians, ~stays), source)
    is_half = is_child | is_parent
    halves = split_half(moved, jnp.where(is_child, 1.0, -1.0))
    densified = jax.tree.map(
        lambda half, whole: jnp.where(is_half.reshape(-1, *[1] * (whole.ndim - 1)), half, whole), halves, moved
    )
    return densified, Moves(source, is_half | ~is_alive(densified))


def _make_room(
    stays: Array, splitting: Array, statistics: ErrorStatistics, count: Array, share: float
) -> tuple[Array, Array]:
    """Which of those that stay do so once the least seen have made room, and how many of `splitting` split.

    There are `count` then, of which a `share` moves.
    """
    moving = (share * count.astype(jnp.float32)).astype(jnp.int32)
    staying = jnp.sum(stays, dtype=jnp.int32)
    most = jnp.sum(stays & (statistics.error > 0), dtype=jnp.int32)
    births = jnp.clip(count + moving - staying, 0, most)
    # What was in no view of late may be needed in the next.
    expendable = stays & ~mark(splitting, births) & (statistics.views > 0)
    most = jnp.minimum(moving, jnp.sum(expendable, dtype=jnp.int32))
    evicted = jnp.clip(staying + births - count, 0, most)
    stays &= ~mark(_ranked(expendable, statistics.weight), evicted)
    return stays, jnp.minimum(births, count - staying + evicted)


def split_half(gaussians: Gaussians, side: Array) -> Gaussians:
    """The half of each Gaussian on the `side` `[N]` (-1 or 1) of its longest axis.

    Both together have its mean and, without overlap, its covariance; and their opacity is the one with which a view
    from the side shows the same sum along that axis: the integral of 1 - (1 - a)(1 - b) over two halves is that of the
    whole.
    """
    along = jax.nn.one_hot(jnp.argmax(gaussians.log_scales, -1), 3, dtype=gaussians.means.dtype)
    offset = jnp.sum(rotation_matrices(gaussians.quats) * (along * scales(gaussians))[:, None, :], axis=-1)
    # 2 o' r - OVERLAP r o'^2 = o, where r is `SHORTER`.
    per_length = opacities(gaussians) / SHORTER
    opacity = per_length / (1 + jnp.sqrt(1 - float(OVERLAP) * per_length))
    return replace(
        gaussians,
        means=gaussians.means + APART * side[:, None] * offset,
        log_scales=gaussians.log_scales + float(np.log(SHORTER)) * along,
        logit_opacities=jnp.log(opacity) - jnp.log1p(-opacity),
    )


def _ranked(eligible: Array, order: Array) -> Array:
    """`[N]` int32 rows, the eligible ones first, by ascending `order`; the earlier row first among equals."""
    return jnp.lexsort((order, ~eligible)).astype(jnp.int32)
