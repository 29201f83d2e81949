"""How long the pair buffer of a step must be, and what is said where there is no room."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array

from gsjax import rendering
from gsjax.errors import InputError, is_out_of_memory
from gsjax.gaussians import Gaussians
from gsjax.scene import batches
from gsjax.scene.batches import Batches
from rasterizer.engines import resolve


class Headroom(NamedTuple):
    """How many times longer than needed the pair buffer is made: a view that needs more costs another compilation."""

    densifying: float  # while Gaussians densify
    still: float  # while they do not


STILL = 1.25
HEADROOM = {
    "native": Headroom(8.0, 2.0),  # writes no slot that nobody needs
    "pallas": Headroom(4.0, 2.0),  # a million more slots take a quarter of a millisecond of an H100
}
SORTS_ALL = Headroom(2.0, STILL)  # in jnp every slot is sorted in every step, used or not


def headroom(*, grows: bool) -> float:
    """How much longer than needed to make the pair buffer of a phase."""
    of_engine = HEADROOM.get(resolve("auto"), SORTS_ALL)
    return of_engine.densifying if grows else of_engine.still


def largest_need(gaussians: Gaussians, data: Batches) -> int:
    """Pair capacity that serves every one of the views."""
    return rendering.largest_need(gaussians, (each.camera for each in data.views))


def chosen_capacity(gaussians: Gaussians, data: Batches, *, headroom: float = STILL) -> int:
    """Pair capacity that holds every view with room to grow; tighter than the buckets of the front door."""
    return rounded_capacity(largest_need(gaussians, data), headroom)


def rounded_capacity(needed: int, headroom: float) -> int:
    """`needed` times `headroom`, up to the next multiple of 4096."""
    return -(-int(needed * headroom + 1) // 4096) * 4096


def kept_or(length: int, headroom: float, before: int | None) -> int:
    """The buffer of before, whose programs are compiled, where it is no longer than `length` and will not be too short.

    `length` is `headroom` times what is needed.
    """
    return before if before is not None and STILL * length / headroom <= before <= length else length


def is_compiled_anew(before: Any, state: Any) -> bool:
    """Whether a state's buffers are of other lengths than before, so that the next step is another program."""

    def shapes(tree: Any) -> list[tuple[int, ...]]:
        return [np.shape(leaf) for leaf in jax.tree.leaves(tree)]

    return state is not before and shapes(state) != shapes(before)


def can_stream(state: Any, data: Batches, view_share: float) -> bool:
    """Whether the photos are on the device, and the step that had no room has left the state there."""
    resident = 0 < data.num_bytes <= batches.device_room(view_share)
    return resident and not any(leaf.is_deleted() for leaf in jax.tree.leaves(state) if isinstance(leaf, Array))


def no_room(error: Exception, data: Batches, capacity: int) -> Exception:
    """The one line for a device whose memory is full; any other error is a bug and stays what it is."""
    if not is_out_of_memory(error):
        return error
    width, height = data.size
    return InputError(
        f"the device has no room for a step at {width}x{height} with {capacity:,} pairs; "
        "make the photos smaller (photos.downscale) or the Gaussians fewer (model.max_gaussians)"
    )
