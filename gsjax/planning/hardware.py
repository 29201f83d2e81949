"""The devices of a run: chosen, checked, and how a state gets there and back."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import jax
import optax

from gsjax.errors import InputError
from gsjax.settings import AUTO, NONE, Settings
from gsjax.training import buffers
from gsjax.training.loop import Placement, one_device
from gsjax.training.sharded import layout
from gsjax.training.sharded.placement import placement
from gsjax.training.state import TrainState

Devices = int | Literal["all"]


@dataclass(frozen=True)
class Hardware:
    """Where a run lies."""

    placement: Placement
    deal: Callable[[TrainState], TrainState]  # a whole state -> the state as it lies there
    whole: Callable[[TrainState], TrainState]  # and back
    is_one: bool  # one device with a view a step


def count_devices(devices: Devices) -> int:
    """How many devices are meant.

    Raises:
        InputError: There are not so many.
    """
    found = jax.devices()
    count = len(found) if devices == "all" else devices
    if count > len(found):
        hint = f"; on a CPU, XLA_FLAGS=--xla_force_host_platform_device_count={count} makes so many"
        raise InputError(f"--devices {devices}: there are {len(found)}{hint if found[0].platform == 'cpu' else ''}")
    if jax.process_count() > 1 and count < len(found):
        raise InputError(f"--devices {devices}: several processes use all devices that they have, {len(found)}")
    return count


def hardware(devices: Devices, views: int, optimizer: optax.GradientTransformation) -> Hardware:
    """One device with a view a step, or Gaussians by rows over several.

    Args:
        devices: How many, or all that there are, those of the other processes included.
        views: Of a step.
        optimizer: Of the run.

    Raises:
        InputError: There are not so many, or the run cannot be spread over them.
    """
    count = count_devices(devices)
    if count == views == 1:
        return Hardware(one_device(), lambda state: state, lambda state: state, is_one=True)
    if views % count:
        raise InputError(f"--views-per-step {views}: is no multiple of {count} devices")
    mesh = layout.mesh_of(jax.devices()[:count])

    def deal(state: TrainState) -> TrainState:
        total = -(-state.gaussians.num_gaussians // count) * count
        return layout.deal_rows(buffers.lengthen(state, optimizer, total), mesh)

    return Hardware(placement(mesh, views), deal, partial(layout.gather_rows, mesh=mesh), is_one=False)


def effects_asked(settings: Settings, devices: Devices) -> str:
    """The effects that were asked for, "auto" turned to none where a step has several views, which knows none.

    A line says so.
    """
    if settings.effects != AUTO or settings.views_per_step == count_devices(devices) == 1:
        return settings.effects
    print("train: effects need one device and one photo a step: nobody looks for any", file=sys.stderr)
    return NONE
