"""Splats change places: devices that hold Gaussians by rows and views one each send every splat to its view's device.

A stage between projection and binning, for several devices only. A device projects its own Gaussians into a view, packs
those that show there into a buffer of fixed length, does so for every device's view, and all buffers change places at
once. What travels is what binning and blending read of a splat, not the Gaussian; gradients go back the same way.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from rasterizer.projection import Projection

OWN_COLUMNS = 9  # mean x and y, conic xx xy yy, extent x and y, depth, opacity; slopes and features follow


class Packed(NamedTuple):
    """What one device has to send to one view."""

    rows: Array  # [K, W] its splats that show there, in their order, see `unpack`; then zeros
    ids: Array  # [K] int32 which Gaussian each is, N in an empty slot
    needed: Array  # [] int32 splats that show there
    overflowed: Array  # [] bool, needed > K: splats are missing and an image made without them is wrong


def pack(projection: Projection, opacities: Array, features: Array, capacity: int) -> Packed:
    """The splats that show in one view, brought together.

    Args:
        projection: Splats of one camera and N Gaussians, with slopes or without.
        opacities: `[N]` as the pixels see them: where antialiasing dims splats, dimmed already.
        features: `[N, D]` channels of any meaning.
        capacity: K, the most that are sent. Static.

    Returns:
        `Packed`; its rows are differentiable to means2d, conics, depths and slopes, opacities and features.
    """
    parts = [projection.means2d[0], projection.conics[0], jax.lax.stop_gradient(projection.extents[0])]
    parts += [projection.depths[0][:, None], opacities[:, None]]
    if projection.slopes is not None:
        parts.append(projection.slopes[0])
    visible = projection.visible[0]
    count = visible.shape[0]
    place = jnp.cumsum(visible, dtype=jnp.int32) - 1
    ids = jnp.full(capacity, count, jnp.int32)
    ids = ids.at[jnp.where(visible, place, capacity)].set(jnp.arange(count, dtype=jnp.int32), mode="drop")
    rows = jnp.concatenate([*parts, features], -1).at[ids].get(mode="fill", fill_value=0)
    needed = jnp.sum(visible, dtype=jnp.int32)
    return Packed(rows, ids, needed, needed > capacity)


def exchange(rows: Array, axis_name: str) -> Array:
    """All devices' buffers change places. Inside `jax.shard_map`.

    Args:
        rows: `[V, K, W]` packed for the view of each of the axis' V devices, in their order.
        axis_name: Of the mesh.

    Returns:
        `[V * K, W]` what the V devices packed for this one's view, in their order. Differentiable.
    """
    return jax.lax.all_to_all(rows, axis_name, split_axis=0, concat_axis=0, tiled=True).reshape(-1, rows.shape[-1])


def unpack(rows: Array, *, with_slopes: bool) -> tuple[Projection, Array, Array]:
    """Rows as the stages after projection read them.

    Args:
        rows: `[M, W]` of `pack`.
        with_slopes: Whether the projection that was packed had slopes. Static.

    Returns:
        The splats of one camera, `[M]` opacities and `[M, D]` features. Empty slots are not visible.
    """
    means2d, conics, extents, depths, opacities = jnp.split(rows[:, :OWN_COLUMNS], [2, 5, 7, 8], axis=-1)
    depths, slopes, features = depths[:, 0], None, rows[:, OWN_COLUMNS:]
    if with_slopes:
        slopes, features = features[:, :2], features[:, 2:]
    # What shows is in front of its camera, and an empty slot is not: its depth is zero.
    visible = jax.lax.stop_gradient(depths) > 0
    batched = (part[None] for part in (means2d, depths, conics, jax.lax.stop_gradient(extents), visible))
    return Projection(*batched, slopes=None if slopes is None else slopes[None]), opacities[:, 0], features
