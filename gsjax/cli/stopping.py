"""The end of a command: by Ctrl-C or SIGTERM, after it has cleaned up, and without tearing libraries down."""

import atexit
import os
import signal
import sys
from contextlib import suppress
from types import FrameType
from typing import Any, NoReturn, Self

SIGNALS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}

_exit_codes: list[int] = []  # One, once the command is over.


class Stopping:
    """While the context lasts, SIGINT raises KeyboardInterrupt and SIGTERM raises SystemExit in the main thread.

    A signal that this process ignores stays ignored.

    Attributes:
        signal: The first signal that arrived; None: none has.
    """

    def __init__(self):
        self.signal: signal.Signals | None = None
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> Self:
        for number in SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                self._handlers[number] = signal.signal(number, self._raise)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _raise(self, number: int, frame: FrameType | None) -> NoReturn:
        self.signal = self.signal or signal.Signals(number)
        if _is_loading("jax"):  # An exception within the import of its compiled modules would abort the process.
            print(f"gsjax: {SIGNALS[self.signal]}", file=sys.stderr)
            _exit_now(128 + number)
        raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)


def skip_teardown() -> None:
    """Let the process end after the exit functions of all libraries: freeing their objects takes seconds.

    Call this before they are imported: the exit function that is registered first runs last.
    """
    atexit.register(lambda: _exit_codes and _exit_now(_exit_codes[0]))


def leave(code: int) -> NoReturn:
    """End the process with a command's exit code.

    After a signal no exit function runs: a library's thread may still compile, and Python's end would crash it.
    """
    if code in {128 + number for number in SIGNALS}:
        _exit_now(code)
    _exit_codes.append(code)
    sys.exit(code)


def _is_loading(package: str) -> bool:
    spec = getattr(sys.modules.get(package), "__spec__", None)
    return bool(getattr(spec, "_initializing", False))


def _exit_now(code: int) -> NoReturn:
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)
