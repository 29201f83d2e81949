"""Pictures that browsers wait for: a coarse one while the camera moves, the full one once it rests."""

import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import NamedTuple

from gsjax.viewer.page_camera import PageCamera

REST = 0.25  # Seconds without a move after which a camera rests.


class Request(NamedTuple):
    """A picture to draw."""

    browser: Hashable
    camera: PageCamera
    is_full: bool


@dataclass
class _Browser:
    camera: PageCamera
    moved_at: float
    wants_coarse: bool = True
    wants_full: bool = True


class PictureQueue:
    """Requests of browsers, one picture after the other; only the newest camera of each counts.

    Any thread may report a camera; one thread takes requests.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._browsers: dict[Hashable, _Browser] = {}
        self._changed = threading.Condition()
        self.is_closed = self._woken = False
        self.is_idle = False  # all pictures are drawn, and none is to come without a move

    def __len__(self) -> int:
        with self._changed:
            return len(self._browsers)

    def move(self, browser: Hashable, camera: PageCamera) -> None:
        """A browser came, or its camera moved."""
        with self._changed:
            self._browsers[browser] = _Browser(camera, self._clock())
            self._changed.notify()

    def remove(self, browser: Hashable) -> None:
        """A browser is gone; nothing of it is kept."""
        with self._changed:
            self._browsers.pop(browser, None)
            self._changed.notify()

    def redraw(self, *, only_full: bool = False) -> None:
        """Request new pictures for every browser, or only the full one, once their camera rests."""
        with self._changed:
            for state in self._browsers.values():
                state.wants_full = True
                state.wants_coarse |= not only_full
            self._changed.notify()

    def wake(self) -> None:
        """Lets `take` return without a request, once."""
        with self._changed:
            self._woken = True
            self._changed.notify()

    def close(self) -> None:
        """No more requests."""
        with self._changed:
            self.is_closed = True
            self._changed.notify()

    def take(self, timeout: float | None = None) -> Request | None:
        """The next request: coarse pictures first, the browser that waits longest first.

        Without one it waits until a camera rests, something changes or the timeout in seconds is over; None where there
        is none even then, and once the queue is closed.
        """
        with self._changed:
            request, rests_in = self._next(self._clock())
            if request is None and not (self._woken or self.is_closed):
                self.is_idle = rests_in is None
                self._changed.wait(min((s for s in (timeout, rests_in) if s is not None), default=None))
                self.is_idle = False
                request, _ = self._next(self._clock())
            self._woken = False
            return None if self.is_closed else request

    def _next(self, now: float) -> tuple[Request | None, float | None]:
        """The request that is due, or after how many seconds the next camera rests."""
        longest_first = sorted(self._browsers.items(), key=lambda item: item[1].moved_at)
        for browser, state in longest_first:
            if state.wants_coarse:
                state.wants_coarse = False
                return Request(browser, state.camera, False), None
        waiting = [(browser, state) for browser, state in longest_first if state.wants_full]
        for browser, state in waiting:
            if now - state.moved_at >= REST:
                state.wants_full = False
                return Request(browser, state.camera, True), None
        return None, min((state.moved_at + REST - now for _, state in waiting), default=None)
