"""Who waits for which picture: a coarse one while the camera moves, the full one once it rests."""

import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import NamedTuple

from gsjax.viewer.page_camera import PageCamera

REST = 0.25  # Seconds without a move after which a camera rests.


class Order(NamedTuple):
    """A picture to draw."""

    who: Hashable
    camera: PageCamera
    is_full: bool


@dataclass
class _Visitor:
    camera: PageCamera
    moved_at: float
    wants_coarse: bool = True
    wants_full: bool = True


class Desk:
    """Takes what browsers tell, hands out one picture after the other; only the newest camera of each counts.

    May be told from any thread; one thread takes orders.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        """Nobody is there yet."""
        self._clock = clock
        self._visitors: dict[Hashable, _Visitor] = {}
        self._changed = threading.Condition()
        self._closed = self._woken = self._idle = False

    def __len__(self) -> int:
        """How many browsers are there."""
        with self._changed:
            return len(self._visitors)

    def moved(self, who: Hashable, camera: PageCamera) -> None:
        """A browser came, or its camera moved."""
        with self._changed:
            self._visitors[who] = _Visitor(camera, self._clock())
            self._changed.notify()

    def left(self, who: Hashable) -> None:
        """A browser is gone; nothing of it is kept."""
        with self._changed:
            self._visitors.pop(who, None)
            self._changed.notify()

    def again(self, *, only_full: bool = False) -> None:
        """What is shown changed: everyone gets new pictures, or only the full one, once their camera rests."""
        with self._changed:
            for visitor in self._visitors.values():
                visitor.wants_full = True
                visitor.wants_coarse |= not only_full
            self._changed.notify()

    def wake(self) -> None:
        """Lets `take` return without an order, once."""
        with self._changed:
            self._woken = True
            self._changed.notify()

    def close(self) -> None:
        """No more orders."""
        with self._changed:
            self._closed = True
            self._changed.notify()

    def take(self, timeout: float | None = None) -> Order | None:
        """Waits for the next order: coarse pictures first, whoever waits longest.

        Args:
            timeout: Seconds; None: for ever.

        Returns:
            The order; None after the timeout, when woken, or once the desk is closed.
        """
        until = None if timeout is None else self._clock() + timeout
        with self._changed:
            while not self._closed:
                now = self._clock()
                order, rests_in = self._next(now)
                if order is not None:
                    return order
                if self._woken:
                    self._woken = False
                    return None
                left = None if until is None else until - now
                if left is not None and left <= 0:
                    return None
                waits = [seconds for seconds in (left, rests_in) if seconds is not None]
                self._idle = rests_in is None
                self._changed.wait(min(waits, default=None))
                self._idle = False
        return None

    @property
    def is_closed(self) -> bool:
        """Whether `close` was called."""
        return self._closed

    @property
    def is_idle(self) -> bool:
        """Whether all pictures are drawn: somebody waits for orders, and none is to come without a move."""
        return self._idle

    def _next(self, now: float) -> tuple[Order | None, float | None]:
        """The order that is due, or after how many seconds the next camera rests."""
        longest_first = sorted(self._visitors.items(), key=lambda item: item[1].moved_at)
        for who, visitor in longest_first:
            if visitor.wants_coarse:
                visitor.wants_coarse = False
                return Order(who, visitor.camera, False), None
        waiting = [(who, visitor) for who, visitor in longest_first if visitor.wants_full]
        for who, visitor in waiting:
            if now - visitor.moved_at >= REST:
                visitor.wants_full = False
                return Order(who, visitor.camera, True), None
        return None, min((visitor.moved_at + REST - now for _, visitor in waiting), default=None)
