"""Gaussians by rows over several devices: where each row lies, and how arrays come there and back.

Rows are dealt like cards: row i of a run on one device is row i // D of device i mod D. So every device has its share
of the living and the free, of near and far, whatever the order in which Gaussians were made, and a row has the same
number on any count of devices. Arrays of a state are rows, or scalars that every device has.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.experimental import multihost_utils
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

AXIS = "devices"
BY_ROWS, EVERYWHERE = PartitionSpec(AXIS), PartitionSpec()
T = TypeVar("T")  # A pytree of arrays.


def mesh_of(devices: Sequence[Any]) -> Mesh:
    """The devices in a row."""
    return jax.make_mesh((len(devices),), (AXIS,), axis_types=(AxisType.Auto,), devices=devices)


def specs(tree: Any) -> Any:
    """How every array of a state lies: those with an axis by rows, scalars everywhere."""
    return jax.tree.map(lambda leaf: BY_ROWS if leaf.ndim else EVERYWHERE, tree)


def on_shards(f: Callable[..., T], mesh: Mesh, state: Any, *rest: Any) -> T:
    """`f(state, *rest)` on every device's rows; `rest` is the same everywhere, and the result lies as a state does."""
    in_specs = specs(state), *(EVERYWHERE for _ in rest)
    # Loops carry values that differ between devices, which the check of replication does not follow.
    return jax.shard_map(f, mesh=mesh, in_specs=in_specs, out_specs=specs(state), check_vma=False)(state, *rest)


def deal_rows(state: T, mesh: Mesh) -> T:
    """A state of one device, its rows a multiple of the devices, on the mesh. Every process holds the same state."""

    def placed(leaf: Array) -> Array:
        whole = np.asarray(leaf)
        if whole.ndim:
            by_turn = whole.reshape(len(whole) // mesh.size, mesh.size, *whole.shape[1:])
            whole = np.ascontiguousarray(by_turn.swapaxes(0, 1)).reshape(whole.shape)
        sharding = NamedSharding(mesh, BY_ROWS if whole.ndim else EVERYWHERE)
        return jax.make_array_from_callback(whole.shape, sharding, lambda index: whole[index])

    return jax.tree.map(placed, state)


def gather_rows(state: T, mesh: Mesh) -> T:
    """What `deal_rows` was given, numpy. All processes take part, and all get it."""

    def whole(leaf: Array) -> np.ndarray:
        rows = np.asarray(leaf if leaf.is_fully_addressable else multihost_utils.process_allgather(leaf, tiled=True))
        if not rows.ndim:
            return rows
        by_device = rows.reshape(mesh.size, len(rows) // mesh.size, *rows.shape[1:])
        return np.ascontiguousarray(by_device.swapaxes(0, 1)).reshape(rows.shape)

    return jax.tree.map(whole, state)


def all_rows(own: T) -> T:
    """Inside `jax.shard_map`: the rows of all devices, `[N / D, ...]` -> `[N, ...]`, by their numbers."""

    def joined(leaf: Array) -> Array:
        by_device = jax.lax.all_gather(leaf, AXIS)
        return jnp.swapaxes(by_device, 0, 1).reshape(leaf.shape[0] * len(by_device), *leaf.shape[1:])

    return jax.tree.map(joined, own)


def own_rows(everyone: T) -> T:
    """Inside `jax.shard_map`: a device's own of `all_rows`."""
    place, count = jax.lax.axis_index(AXIS), jax.lax.axis_size(AXIS)
    return jax.tree.map(lambda leaf: leaf.reshape(leaf.shape[0] // count, count, *leaf.shape[1:])[:, place], everyone)


def fetch_rows(own: T, source: Array) -> T:
    """Inside `jax.shard_map`: rows by their numbers, whoever has them.

    The shards go round once, so no device ever holds more than two.

    Args:
        own: Arrays `[N / D, ...]`.
        source: `[M]` int32 numbers of rows, 0 to N - 1; those that each device wants for itself.

    Returns:
        Arrays `[M, ...]`.
    """
    place, count = jax.lax.axis_index(AXIS), jax.lax.axis_size(AXIS)
    to_previous = [(index, (index - 1) % count) for index in range(count)]

    def turn(index: Array, carry: tuple[T, T]) -> tuple[T, T]:
        passing, taken = carry
        is_here = source % count == (place + index) % count

        def chosen(here: Array, before: Array) -> Array:
            return jnp.where(is_here.reshape(-1, *[1] * (before.ndim - 1)), here[source // count], before)

        taken = jax.tree.map(chosen, passing, taken)
        return jax.tree.map(lambda leaf: jax.lax.ppermute(leaf, AXIS, to_previous), passing), taken

    nothing = jax.tree.map(lambda leaf: jnp.zeros((len(source), *leaf.shape[1:]), leaf.dtype), own)
    return jax.lax.fori_loop(0, count, turn, (own, nothing))[1]
