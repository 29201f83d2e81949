"""A folder that one process at a time works in."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gsjax.errors import InputError
from gsjax.io.files import unwritable

LOCK = ".lock"


@contextmanager
def lock_folder(folder: str | Path) -> Iterator[None]:
    """Keeps a folder for this process until the block ends, or the process does, by a file `LOCK` that stays in it.

    On a file system that has no locks, nothing is kept.

    Raises:
        InputError: Another process has it, or it cannot be written.
    """
    try:
        handle = os.open(Path(folder) / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise unwritable(folder, error) from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(f"{folder}: another process is at work in this folder; wait until it ends") from error
        except OSError:
            pass
        yield
    finally:
        os.close(handle)
