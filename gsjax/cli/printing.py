"""What is printed, where nobody takes it: into a pipe that was closed, onto a full disk."""

import os
import signal
import sys
from contextlib import suppress
from types import TracebackType
from typing import Any, Self


def open_closed_streams() -> None:
    """Puts the null device in the place of stdin, stdout and stderr where they are closed (`>&-`).

    Else the next file that is opened would have the number of one, and what others print would come into it.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            handle = os.open(os.devnull, os.O_RDWR)  # The lowest number that is free.
            setattr(sys, name, os.fdopen(handle, "w" if number else "r"))


def tell(line: str) -> None:
    """Prints a line on stderr, if anybody takes it."""
    with suppress(OSError):
        print(line, file=sys.stderr)


class Printing:
    """While it lasts, stdout remembers the error that something printed has met; at the end all is printed."""

    def __init__(self):
        """Nothing printed yet."""
        self.stream: Any = sys.stdout
        self.failure: OSError | None = None

    def __enter__(self) -> Self:
        """Take stdout's place."""
        self.stream, sys.stdout = sys.stdout, self
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give it back."""
        sys.stdout = self.stream
        if error is None:
            self.flush()

    def write(self, text: str) -> int:
        """As stdout's own."""
        try:
            return self.stream.write(text)
        except OSError as error:
            self.failure = error
            raise

    def flush(self) -> None:
        """As stdout's own."""
        try:
            self.stream.flush()
        except OSError as error:
            self.failure = error
            raise

    def __getattr__(self, name: str) -> Any:
        """The rest of what stdout can do."""
        return getattr(self.stream, name)

    def exit_code(self, error: BaseException) -> int | None:
        """The exit code where an error is that of printing, after which nothing more is printed; None: it is another.

        That is 141 where a pipe was closed, as in `gsjax eval RUN | head -3`: the code that shells give to SIGPIPE.
        Else 2, after a line on stderr.
        """
        if error is not self.failure or self.failure is None:
            return None
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.stream.fileno())
        if isinstance(error, BrokenPipeError):
            return 128 + signal.SIGPIPE
        tell(f"gsjax: error: what is printed cannot be written: {self.failure.strerror}")
        return 2
