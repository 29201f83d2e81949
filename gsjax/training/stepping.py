"""The steps of one program, one after the other: which view, and when the pair buffer must grow."""

import logging
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Generic, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh

from gsjax.errors import InputError, is_out_of_memory
from gsjax.scene import batches
from gsjax.scene.batches import Batch, Batches
from gsjax.training import data_parallel
from gsjax.training.capacity import STILL, can_stream, is_compiled_anew, no_room, rounded_capacity
from gsjax.training.step import Metrics
from gsjax.training.terms import LossTerm
from gsjax.training.terms.multi_view import draw_neighbor

S = TypeVar("S")  # A state of training.
TakeStep = Callable[[S, Batch, Array], tuple[S, Metrics]]

logger = logging.getLogger("gsjax")

VIEW_SHARE = 0.5  # Of the device's memory, for photos; beyond it, and where the device is full, they are streamed.
NOT_FINITE = "the loss or a gradient is not finite"

Feed = Callable[[Batches, int, float], Callable[[int], Batch]]
"""(photos, seed of their order, share of the device's memory) -> steps done -> what the next step compares with."""


class Program(Generic[S]):
    """A compiled step, and its pair buffer that grows: a run and a loop of one's own take their steps by it."""

    def __init__(self, compiled: Callable[[int], TakeStep[S]], capacity: int, room: float):
        """`compiled` is pair capacity -> step, which leaves the state as it was where it overflows.

        A buffer that was too short becomes `room` times as long as needed.
        """
        self.compiled, self.capacity, self.room = compiled, capacity, room
        self.step = compiled(capacity)

    def lengthen(self, needed: Any, least: int = 0) -> None:
        """Compile for a buffer that holds so many pairs."""
        self.capacity = max(least, rounded_capacity(int(needed), self.room))
        self.step = self.compiled(self.capacity)

    def whole_step(self, state: S, view: Batch, key: Array) -> tuple[S, Metrics]:
        """One step, repeated until it does not overflow."""
        while True:
            state, metrics = self.step(state, view, key)
            if not metrics.overflowed:
                return state, metrics
            self.lengthen(metrics.needed)


def view_order(seed: int, step: int, num_views: int) -> int:
    """The view of a step: a fresh random permutation every epoch, a function of (seed, step) alone."""
    epoch, position = divmod(step, num_views)
    return int(np.random.default_rng((seed, epoch)).permutation(num_views)[position])


def one_view(data: Batches, seed: int, view_share: float) -> Callable[[int], Batch]:
    """A `Feed` of one device: the view of each step in `view_order`, the next one on its way meanwhile.

    Where the views have neighbours, one of them is next to each.
    """
    fed = batches.feed(data, room=batches.device_room(view_share))
    return lambda step: _joined(*fed(_views_of(data, seed, step), _views_of(data, seed, step + 1)))


def _views_of(data: Batches, seed: int, place: int) -> list[int]:
    """The view of a place in the order of `seed`, and its neighbour where views have some."""
    view = view_order(seed, place, data.num_views)
    return [view] if data.neighbors is None else [view, draw_neighbor(data.neighbors[view], seed, place)]


def _joined(view: Batch, neighbor: Batch | None = None) -> Batch:
    return view if neighbor is None else replace(view, neighbor=neighbor)


def several_views(
    data: Batches, seed: int, view_share: float, *, mesh: Mesh, views_per_step: int
) -> Callable[[int], Batch]:
    """A `Feed` of a mesh: the views that one device would take one by one, so many at a time, in shares of the devices.

    They are streamed: a device holds its views of a step and of the next one.
    """
    del view_share

    def of_place(place: int) -> Batch:
        return _joined(*(data.views[index] for index in _views_of(data, seed, place)))

    def stacked(step: int) -> Batch:
        places = range(step * views_per_step, (step + 1) * views_per_step)
        return data_parallel.stack_views([of_place(place) for place in places], mesh)

    ahead: dict[int, Batch] = {}

    def target(step: int) -> Batch:
        here = ahead.pop(step) if step in ahead else stacked(step)
        ahead.clear()
        ahead[step + 1] = stacked(step + 1)
        return here

    return target


def advance(
    compiled: Callable[[int], TakeStep[S]],
    after: Callable[[int, S, Metrics, int], S],
    state: S,
    data: Batches,
    steps: tuple[int, int],
    *,
    seed: int,
    capacity: int,
    room: float = STILL,
    feed: Feed = one_view,
    looks: Callable[[int], bool] | None = None,
    explain: Callable[[int, S, Batch, int], str] = lambda step, state, target, capacity: NOT_FINITE,
) -> tuple[S, int]:
    """Take the steps of one program, each with its view, and make room where a view needs it.

    Args:
        compiled: As in `Program`.
        after: (steps done, state, metrics, capacity) -> state, after every step.
        state: Where to start.
        data: The views.
        steps: Steps done so far, and at the end.
        seed: Of the order of views, and of the key that every step gets.
        capacity: Pair buffer to start with.
        room: As in `Program`.
        feed: What a step compares with.
        looks: Steps done -> whether `after` reads their state. After others the next step is begun before it is
            known whether this one overflowed, so that a GPU never waits, and `after` gets a later state. The numbers
            are the same. None: it always looks.
        explain: (steps done, state, what the next step compares with, capacity) -> what is wrong with a step whose loss
            or gradients are not finite, see `describe_fault`.

    Returns:
        The state after the last step, and the pair buffer's length by then.

    Raises:
        InputError: The device has no room, or a loss or a gradient is not finite. That step is not taken.
    """
    key, program = jax.random.key(seed), Program(compiled, capacity, room)
    done, end = steps
    ahead = None if looks is None else int(state.step) - done  # pyright: ignore[reportAttributeAccessIssue]
    targets = _Targets(feed, data, seed, ahead)
    pending: list[Metrics] = []  # of the steps after `done`
    needed = deque(maxlen=data.num_views)  # by the last steps
    while done < end:
        step = done + len(pending)
        try:
            state, metrics = program.step(state, targets(step), key)
            pending.append(metrics)
            is_seen = looks is None or step + 1 == end or looks(step + 1)
            to_check = pending if is_seen else pending[:-1]
            num_taken = next((index for index, each in enumerate(to_check) if not _is_taken(each)), len(to_check))
        except jax.errors.JaxRuntimeError as error:
            targets.stream(error, state, program.capacity)
            continue
        for metrics in to_check[:num_taken]:
            done += 1
            needed.append(metrics.needed)
            before, state = state, after(done, state, metrics, program.capacity)
            if is_compiled_anew(before, state):  # The pairs get their room in the same compilation.
                program.lengthen(max(map(int, needed)), least=program.capacity)
        missed, pending = to_check[num_taken:], pending[num_taken:]
        if missed:  # What was begun after it has left the state as it was, too.
            if not missed[0].overflowed:
                fault = explain(done, state, targets(done), program.capacity)
                raise InputError(f"step {done + 1:,}, {fault}; training stops before it and keeps what it saved")
            program.lengthen(missed[0].needed)
            pending = []
    return state, program.capacity


class _Targets:
    """What each step compares with. Once the device was full, photos are sent to it one by one."""

    def __init__(self, feed: Feed, data: Batches, seed: int, ahead: int | None):
        """`ahead` is what `state.step` is more than the steps done; None: no step is begun before its turn."""
        self.feed, self.data, self.seed, self.ahead = feed, data, seed, ahead
        self.view_share, self.fed = VIEW_SHARE, None

    def __call__(self, step: int) -> Batch:
        self.fed = self.fed or self.feed(self.data, self.seed, self.view_share)
        here = self.fed(step)
        return here if self.ahead is None else replace(here, turn=np.int32(step + self.ahead))

    def stream(self, error: Exception, state: Any, capacity: int) -> None:
        """Free the photos on the device after this error; raise it where that frees nothing, or it is another one."""
        if not is_out_of_memory(error) or not can_stream(state, self.data, self.view_share):
            raise no_room(error, self.data, capacity) from error
        logger.warning("the device is full: photos are sent to it one by one from here on")
        self.view_share, self.fed = 0.0, None


def _is_taken(metrics: Metrics) -> bool:
    """Whether a step has changed the state."""
    overflowed, finite = jax.device_get((metrics.overflowed, metrics.finite))
    return bool(finite) and not overflowed


def describe_fault(
    terms: Iterable[LossTerm],
    step_of: Callable[[tuple[LossTerm]], TakeStep[S]],
    state: S,
    target: Batch,
    data: Batches,
    *,
    seed: int,
    places: Iterable[int],
) -> str:
    """Which photos, and which of these terms by the step of each alone, are not finite. The state stays as it is.

    `places` are those of the photos of the step in the order of `seed`.
    """
    faults, key = [], jax.random.key(seed)
    for each in terms:
        _, metrics = step_of((each,))(jax.tree.map(jnp.copy, state), target, key)
        value = float(metrics.terms[each.name])
        if not np.isfinite(value):
            faults.append(f"the loss term '{each.name}' is {value}")
        elif not metrics.finite:
            faults.append(f"the gradient of the loss term '{each.name}' is not finite")
    fault = " and ".join(faults) or f"{NOT_FINITE}, though that of every term alone is"
    views = [view_order(seed, place, data.num_views) for place in places]
    photos = {f"photo {data.names[view] if data.names else view}" for view in views}
    return f"{', '.join(sorted(photos))}: {fault}"
