"""Files read whole, and written so that a target is either the old whole or the new whole, never a half."""

import errno
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gsjax.errors import InputError
from gsjax.io.machine import require_memory
from gsjax.io.temporary_files import behind_link, sweep_beside, temporary_beside, unwritable

PENDING = ".pending"  # in a folder: whole new files, which are to replace the old ones together
_ALWAYS_ROOM = 2**26  # bytes
_COPIES = 3  # of a file, at least, while what it says becomes arrays


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """A temporary name in the folder of `path`, renamed onto `path` when the block ends without an error.

    The temporary name keeps the target's suffix. Its bytes are on the disk before the rename. The parent folder is
    created; after a failure nothing of the block remains, and what a killed writer of `path` has left goes first. Where
    `path` is a link, it stays one, and the file is where it leads. A block that writes nothing is a bug of the caller.

    Raises:
        InputError: The disk is full, read-only, or the like, or `path` is a folder, a device or a pipe; one line with
            `path` and the system's reason.
    """
    path = Path(path)
    _require_replaceable(path)
    place = behind_link(path)
    sweep_beside(place)
    temporary = temporary_beside(place)
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        assert os.path.lexists(temporary), f"{temporary} was not written"
        flush(temporary)
        os.replace(temporary, place)
        flush(place.parent)
    except OSError as error:
        if _is_about_another_file(error, temporary, place):
            raise
        raise unwritable(path, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink()


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """An empty temporary folder next to `path`, renamed onto `path` when the block ends without an error.

    After a failure nothing of the block remains; what one that was killed has left is removed by the next.

    Raises:
        InputError: `path` is neither absent nor empty, or the disk is full, read-only, or the like.
    """
    path = Path(path)
    require_empty(path)
    with workspace(path) as folder:
        yield folder
        put_in_place(folder, path)


def read_bytes(path: str | Path) -> bytes:
    """All of a file.

    Raises:
        InputError: It cannot be read, is a pipe or a device, or has no room in memory.
    """
    try:
        if stat.S_ISREG((status := os.stat(path)).st_mode):
            if status.st_size > _ALWAYS_ROOM:
                require_memory(f"{path}: a file of {status.st_size / 2**30:.3g} GiB", _COPIES * status.st_size)
        elif not stat.S_ISDIR(status.st_mode):
            raise InputError(f"{path}: cannot be read (a pipe or a device, not a file)")
        return Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error


def stamp(path: Path) -> tuple[int, int]:
    """When a file was written, nanoseconds, and its bytes; zeros where it is absent."""
    try:
        status = path.stat()
    except (OSError, ValueError):  # ValueError: of a name that no disk holds.
        return 0, 0
    return status.st_mtime_ns, status.st_size


def require_empty(path: str | Path) -> None:
    """Raises InputError unless a folder of this name can be made, or is there without anything in it."""
    path = Path(path)
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"{path}: exists and is not empty; choose another folder")


@contextmanager
def workspace(path: str | Path) -> Iterator[Path]:
    """A folder next to `path` for what is to become it, removed after the block, as what killed ones have left."""
    path = behind_link(Path(path))
    make_folder(path.parent)
    sweep_beside(path)
    folder = temporary_beside(path)
    try:
        folder.mkdir()
        yield folder
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def put_in_place(folder: Path, path: Path) -> None:
    """Gives a whole folder its name, which is free, an empty folder's, or a link to one of these."""
    target = behind_link(path)
    os.replace(folder, target)
    flush(target.parent)


@contextmanager
def replaced_files(folder: Path) -> Iterator[Path]:
    """An empty folder for new files of `folder`, which replace the files of the same names together after the block.

    If the block fails or is killed, nothing has changed. If the process is killed later, the next `finish_replacement`
    completes the replacement; every reader of the folder calls it.
    """
    finish_replacement(folder)
    with workspace(folder / PENDING) as new_folder:
        yield new_folder
        for file in new_folder.iterdir():
            flush(file)
        put_in_place(new_folder, folder / PENDING)
    finish_replacement(folder)


def finish_replacement(folder: Path) -> None:
    """Puts the files in place that a killed `replaced_files` has left pending."""
    pending = folder / PENDING
    if not pending.is_dir():
        return
    try:
        with suppress(FileNotFoundError):  # Another process does the same.
            for file in sorted(pending.iterdir()):
                with suppress(FileNotFoundError):
                    os.replace(file, folder / file.name)
            flush(folder)
            pending.rmdir()
    except OSError as error:
        raise unwritable(folder, error) from error


@contextmanager
def folder_if_used(path: str | Path) -> Iterator[Path]:
    """A folder that is made for the block; where nothing came into it, it and the parents made for it go again."""
    path = Path(path)
    new_folders = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        yield make_folder(path)
    finally:
        for folder in new_folders:
            with suppress(OSError):  # Not empty, or never made.
                folder.rmdir()


def make_folder(path: str | Path) -> Path:
    """Creates a folder and its parents where absent."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(path, error) from error
    return Path(path)


def _is_about_another_file(error: OSError, temporary: Path, path: Path) -> bool:
    """Whether the block failed on a file of its own: not a fault of the target."""
    if error.filename is None:
        return False
    return Path(os.fsdecode(error.filename)) not in (temporary, path, *path.parents)


def _require_replaceable(path: Path) -> None:
    """Raises InputError where a name refers to something that no file may take the place of."""
    if os.path.isdir(path):
        raise unwritable(path, IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR)))
    if os.path.exists(path) and not os.path.isfile(path):
        raise InputError(f"cannot write {path}: it is a pipe or a device, not a file")


def flush(path: Path) -> None:
    """Waits until the file's bytes (or the folder's list of names) are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
