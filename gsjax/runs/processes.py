"""Several processes that train one run: how they join, and what the first sends to the others."""

import atexit
import os
import pickle
import re
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from pathlib import Path
from typing import TypeVar

import jax
import numpy as np
from jax.experimental import multihost_utils

from gsjax.errors import InputError

T = TypeVar("T")
LOST = re.compile(r"Gloo|NCCL|heartbeat|coordination|UNAVAILABLE", re.IGNORECASE)
"""What the runtime says when another process is gone."""
MOST_PROCESSES = 2**16
PATIENCE = 600  # seconds without a sign of life, after which jax ends the process


@contextmanager
def join_processes(coordinator: str, processes: int | None = None, process: int | None = None) -> Iterator[None]:
    """While this process is one of several that train one run: all are started alike, each with its own number.

    Args:
        coordinator: HOST:PORT of the first process, or "auto" for what the cluster's environment says.
        processes: How many there are; None: as the environment says.
        process: Which one this is, from 0; None: as the environment says.

    Raises:
        InputError: They do not come together, or one was lost. The caller must end the process.
    """
    if coordinator != "auto":
        _check_address(coordinator)
    for name, number, low in (("processes", processes, 1), ("process", process, 0)):
        if number is not None and not low <= number < MOST_PROCESSES:
            raise InputError(f"{name}={number} is not between {low} and {MOST_PROCESSES - 1}")
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    try:
        address = None if coordinator == "auto" else coordinator
        jax.distributed.initialize(address, processes, process, heartbeat_timeout_seconds=PATIENCE)
    except (ValueError, RuntimeError) as error:
        raise InputError(f"coordinator={coordinator}: {str(error).splitlines()[0]}") from error
    try:
        yield
    except InputError:
        atexit.register(os._exit, 2)  # Before jax's own farewell, which waits for those who are gone.
        raise
    except (ValueError, jax.errors.JaxRuntimeError) as error:
        if not LOST.search(str(error)):
            raise
        atexit.register(os._exit, 2)
        raise InputError("another process of this run was lost; resume from the last checkpoint") from error


def _check_address(coordinator: str) -> None:
    """InputError unless there could be somebody: jax would wait for minutes."""
    host, _, port = coordinator.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError(f"coordinator={coordinator}: is no HOST:PORT")
    try:
        socket.getaddrinfo(host.strip("[]"), int(port))
    except (socket.gaierror, UnicodeError) as error:
        raise InputError(f"coordinator={coordinator}: {getattr(error, 'strerror', 'is no name of a host')}") from error


def is_first() -> bool:
    """Whether this process is the one that writes; the only one is."""
    return jax.process_index() == 0


def from_first(tree: T) -> T:
    """What the first process has; all have arrays of the same shapes."""
    return tree if jax.process_count() == 1 else multihost_utils.broadcast_one_to_all(tree)


def same_everywhere(value: T) -> T:
    """What the first process has, of any kind that can be pickled: a decision that all processes must share."""
    if jax.process_count() == 1:
        return value
    pickled = np.frombuffer(pickle.dumps(value), np.uint8)
    length = int(multihost_utils.broadcast_one_to_all(np.int64(len(pickled))))
    padded = np.resize(pickled, length)
    return pickle.loads(multihost_utils.broadcast_one_to_all(padded).tobytes())


@contextmanager
def own_folder(run: str | Path) -> Iterator[Path]:
    """The run folder for the first process. The others work in silence and in a folder that goes away."""
    if is_first():
        yield Path(run)
        return
    with tempfile.TemporaryDirectory() as scratch, open(os.devnull, "w") as silence, redirect_stderr(silence):
        yield Path(scratch) / "run"
