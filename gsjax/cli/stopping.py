"""Ctrl-C and SIGTERM, which end a command wherever it is, after it has cleaned up."""

import atexit
import os
import signal
import sys
from contextlib import suppress
from types import FrameType, TracebackType
from typing import Any, NoReturn, Self

ASKS = {signal.SIGINT: "interrupted", signal.SIGTERM: "asked to end"}
AGAIN = 0.2  # seconds


_left_with: list[int] = []  # The exit code, once a command is over.


def spare_the_teardown() -> None:
    """The process ends when every library has said its farewell: to free what they hold takes seconds, for nobody.

    To be called before they are imported: who asks first to be called at the end is called last.
    """
    atexit.register(_end)


def _end() -> None:
    if _left_with:
        _flush()
        os._exit(_left_with[0])


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()


def leave(code: int) -> NoReturn:
    """Ends the process with a command's exit code.

    A command that was asked to end has cleaned up, and is left at once: a thread of a library may still compile then,
    and Python's own end, which takes away what it uses, would crash it.
    """
    if code in {128 + number for number in ASKS}:
        _flush()
        os._exit(code)
    _left_with.append(code)
    sys.exit(code)


class _Interrupted(KeyboardInterrupt):
    pass


class _Terminated(SystemExit):
    pass


class Stopping:
    """While it lasts, a signal that asks to end raises KeyboardInterrupt or SystemExit until that has come out.

    What a handler raises is lost where nobody hands it on: in callbacks of the garbage collector, in finalizers, in
    native code that calls Python. So it is raised again every `AGAIN` seconds, but not while it is on its way: what
    cleans up is left to finish. A signal that this process was told to ignore stays ignored.

    Attributes:
        signal: The first signal that asked; None: none has.
    """

    def __init__(self):
        """Nobody has asked yet."""
        self.signal: signal.Signals | None = None
        self._lasts = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        """Take the signals, in the main thread."""
        self._lasts = True
        for number in (*ASKS, signal.SIGALRM):
            if signal.getsignal(number) is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._raise)
        self._told, sys.unraisablehook = sys.unraisablehook, self._lost
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give them back."""
        self._lasts = False
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in self._before.items():
            signal.signal(number, handler)
        sys.unraisablehook = self._told

    def _raise(self, number: int, frame: FrameType | None) -> None:
        if not self._lasts:  # It has come out: the command ends.
            return
        if self.signal is None and number not in ASKS:  # Somebody else's alarm.
            return
        if self.signal is None:
            self.signal = signal.Signals(number)
            signal.setitimer(signal.ITIMER_REAL, AGAIN, AGAIN)
        if not _is_on_its_way():
            raise _Interrupted if self.signal == signal.SIGINT else _Terminated(128 + self.signal)

    def _lost(self, unraisable: Any) -> None:
        """Says nothing of an exception of ours that could not be handed on: it comes again."""
        if not isinstance(unraisable.exc_value, _Interrupted | _Terminated):
            self._told(unraisable)


def _is_on_its_way() -> bool:
    """Whether the code that a signal has interrupted handles what an earlier one raised, or what came of that."""
    error = sys.exception()
    while error is not None:
        if isinstance(error, _Interrupted | _Terminated):
            return True
        error = error.__context__
    return False
