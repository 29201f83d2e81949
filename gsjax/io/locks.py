"""A folder that one process at a time works in."""

import fcntl
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
        file = (Path(folder) / LOCK).open("a")
    except OSError as error:
        raise unwritable(folder, error) from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(f"{folder}: another process is at work in this folder; wait until it ends") from error
        except OSError:
            pass
        yield
