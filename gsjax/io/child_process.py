"""A function in a process of its own, with its progress shown here: a crash of a native library is one line here."""

import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from types import SimpleNamespace
from typing import Any, BinaryIO

from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io import messages

_LAST_WORDS = re.compile(rb"(?:what\(\):|^F\d{4,8} .*?\])\s*(\S.*)", re.MULTILINE)  # Of C++, and of Google's log.


def run_in_child(function: Callable, *arguments: Any, name: str, progress: Callable[..., tqdm] = tqdm) -> Any:
    """Calls `function(*arguments, progress)` in a new process, which ends with this call, and returns what it returns.

    Of what the process prints, only messages are shown (`gsjax.io.messages`).

    Args:
        function: Of a module that can be imported. It opens one progress bar at a time.
        arguments: Anything that can be pickled, as must be the result.
        name: What the error of a crash begins with.
        progress: Makes the bars that are shown here, called with tqdm's `total`, `desc` and `unit`.

    Raises:
        InputError: The function raised one, or its process died.
        RuntimeError: The function raised anything else; holds the traceback from there.
    """
    # One thread for each product of matrices: who calls this runs many of them side by side.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "gsjax.io.child_process"]
    with tempfile.TemporaryFile() as log, ExitStack() as stack:
        child = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            env=environment,
            start_new_session=True,  # An interrupt from the keyboard is for us, who then end the child.
        )
        stack.callback(_end, child)
        assert child.stdin and child.stdout  # pipes, as asked for
        with suppress(BrokenPipeError):  # From one that died at once nothing will be heard either.
            pickle.dump((function, arguments), child.stdin)
            child.stdin.flush()
        try:
            return _listen(child.stdout, progress)
        except (EOFError, pickle.UnpicklingError) as error:
            raise InputError(f"{name}: {_cause(child.wait(), log)}") from error


def _listen(stream: BinaryIO, progress: Callable[..., tqdm]) -> Any:
    """Show the bars that the child reports, until its result comes."""
    bar: Any = None
    with ExitStack() as bars:
        while True:
            what, value = pickle.load(stream)
            match what:
                case "open":
                    bars.close()
                    bar = bars.enter_context(progress(**value))
                case "update" | "reset":
                    getattr(bar, what)(*value)
                case "note":
                    messages.print_once(value)
                case "result":
                    return value
                case "unusable":
                    raise InputError(value)
                case "failed":
                    raise RuntimeError(value)


def _end(child: subprocess.Popen) -> None:
    child.kill()
    child.wait()
    for pipe in (child.stdin, child.stdout):
        with suppress(BrokenPipeError):  # What was not sent is not wanted any more.
            if pipe:
                pipe.close()


def _cause(code: int, log: BinaryIO) -> str:
    """How a child ended that said nothing: by which signal, and its last words."""
    log.seek(0)
    output = log.read()
    words = _LAST_WORDS.findall(output) or output.strip().splitlines()
    last = f" ({words[-1].decode(errors='replace').strip()})" if words else ""
    how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
    memory = "; was there memory left?" if code == -signal.SIGKILL else ""
    return f"the process {how}{last}{memory}"


def _serve() -> None:
    """The child: reads a function and its arguments, runs it, and sends its progress to what was standard output."""
    channel = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # Whatever libraries print goes the way of errors.
    lock = threading.Lock()
    messages.show_with(lambda line: tell("note", line))

    def tell(what: str, value: Any) -> None:
        with lock:
            pickle.dump((what, value), channel)
            channel.flush()

    def progress(**settings: Any) -> AbstractContextManager:
        tell("open", settings)
        return nullcontext(SimpleNamespace(update=lambda n=1: tell("update", [n]), reset=lambda: tell("reset", [])))

    try:
        function, arguments = pickle.load(sys.stdin.buffer)
        threading.Thread(target=_leave_with_the_parent, daemon=True).start()
        tell("result", function(*arguments, progress))
    except InputError as error:
        tell("unusable", str(error))
    except Exception:
        tell("failed", traceback.format_exc())


def _leave_with_the_parent() -> None:
    sys.stdin.buffer.read()  # Ends when the parent does.
    os._exit(1)


if __name__ == "__main__":
    _serve()
