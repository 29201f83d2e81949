"""Data parallelism: every device holds the whole state and takes its share of the views of a step.

A step descends the mean loss of its views. Gradients are averaged over the devices, and the statistics of densification
are summed, so that every device makes the same update. Several processes (`jax.distributed`) do the same.
"""

from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeVar

import jax
import numpy as np
from jax import Array
from jax.experimental import multihost_utils
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from gsjax.errors import InputError

AXIS = "devices"  # of the mesh
BY_VIEWS, EVERYWHERE = PartitionSpec(AXIS), PartitionSpec()
T = TypeVar("T")  # A pytree of arrays.


Devices = int | Literal["all"]
"""How many devices a run has; all: those of the other processes too."""


def count_devices(devices: Devices) -> int:
    """How many devices are meant; InputError where there are not so many."""
    there = jax.devices()
    count = len(there) if devices == "all" else devices
    if count > len(there):
        hint = f"; on a CPU, XLA_FLAGS=--xla_force_host_platform_device_count={count} makes so many"
        raise InputError(f"devices={devices}: there are {len(there)}{hint if there[0].platform == 'cpu' else ''}")
    if jax.process_count() > 1 and count < len(there):
        raise InputError(f"devices={devices}: several processes use all devices that they have, {len(there)}")
    return count


def device_mesh(devices: Devices, views_per_step: int) -> Mesh | None:
    """The devices that share the views of a step; None: one device with one view a step.

    Raises:
        InputError: There are not so many, or the views are no multiple of them.
    """
    count = count_devices(devices)
    if views_per_step % count:
        raise InputError(f"views_per_step={views_per_step}: is no multiple of {count} devices")
    if count == views_per_step == 1:
        return None
    return jax.make_mesh((count,), (AXIS,), axis_types=(AxisType.Auto,), devices=jax.devices()[:count])


def replicate(state: T, mesh: Mesh) -> T:
    """A copy of the state on every device of the mesh. Every process holds the same state."""

    def on_all(leaf: Any) -> Array:
        whole = np.asarray(leaf)
        return jax.make_array_from_callback(whole.shape, NamedSharding(mesh, EVERYWHERE), lambda index: whole[index])

    return jax.tree.map(on_all, state)


def stack_views(views: Sequence[T], mesh: Mesh) -> T:
    """The views `[V, ...]` of a step, a share on each device. A process reads only those of its own devices."""

    def by_device(*leaves: Any) -> Array:
        def share(index: tuple[slice, ...]) -> np.ndarray:
            return np.stack([np.asarray(leaf) for leaf in leaves[index[0]]])

        shape = len(leaves), *np.shape(leaves[0])
        return jax.make_array_from_callback(shape, NamedSharding(mesh, BY_VIEWS), share)

    return jax.tree.map(by_device, *views)


def on_mesh(step: Callable[..., T], mesh: Mesh) -> Callable[..., T]:
    """`step(state, views, key)` on every device of the mesh: the same state and key, a share of the views."""
    specs = EVERYWHERE, BY_VIEWS, EVERYWHERE
    # The check of replication does not follow loops whose values differ between devices.
    return jax.shard_map(step, mesh=mesh, in_specs=specs, out_specs=EVERYWHERE, check_vma=False)


def of_first_process(number: int) -> int:
    """The number that the first process has: all processes must compile the same program."""
    return number if jax.process_count() == 1 else int(multihost_utils.broadcast_one_to_all(np.int64(number)))
