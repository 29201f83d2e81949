"""Writing so that a target is either the old whole or the new whole, never a half."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gsjax.errors import InputError
from gsjax.io.temporaries import sweep_beside, temporary_beside


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """A temporary name beside `path`, renamed onto `path` when the block ends without an error.

    The temporary name keeps the target's suffix, so writers that choose a format by suffix work. Its bytes are on
    the disk before the rename. The parent folder is created; after a failure nothing of the block remains.

    Args:
        path: Where the whole file is to be.

    Yields:
        The name to write to. A block that does not write it raises FileNotFoundError: a bug of the caller.

    Raises:
        InputError: The disk is full, read-only, or the like; one line with `path` and the system's reason.
    """
    path = Path(path)
    temporary = temporary_beside(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        flush(temporary)
        os.replace(temporary, path)
        flush(path.parent)
    except OSError as error:
        if _is_about_another_file(error, temporary, path):
            raise
        raise unwritable(path, error) from error
    finally:
        with suppress(OSError):
            temporary.unlink()


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """An empty temporary folder beside `path`, renamed onto `path` when the block ends without an error.

    After a failure nothing of the block remains; what one that was killed has left is removed by the next.

    Args:
        path: Where the whole folder is to be; absent or empty so far, or a link to such a folder.

    Yields:
        The folder to write to.

    Raises:
        InputError: `path` is in use, or the disk is full, read-only, or the like.
    """
    path = Path(path)
    require_empty(path)
    with workspace(path) as folder:
        yield folder
        put_in_place(folder, path)


def require_empty(path: str | Path) -> None:
    """Raises InputError unless a folder of this name can be made, or is there without anything in it."""
    path = Path(path)
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"{path}: exists and is not empty; choose another folder")


@contextmanager
def workspace(path: str | Path) -> Iterator[Path]:
    """A folder beside `path` for what is to become it, gone after the block whatever happens.

    What killed ones have left there is removed first.

    Raises:
        InputError: The disk is full, read-only, or the like.
    """
    path = _behind_link(Path(path))
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
    target = _behind_link(path)
    os.replace(folder, target)
    flush(target.parent)


def _behind_link(path: Path) -> Path:
    return Path(os.path.realpath(path)) if path.is_symlink() else path


@contextmanager
def folder_if_used(path: str | Path) -> Iterator[Path]:
    """A folder that is made for the block, and taken away again, with parents made for it, where nothing came into it.

    Raises:
        InputError: It cannot be created, or a file has its name.
    """
    path = Path(path)
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        yield make_folder(path)
    finally:
        for folder in made:
            with suppress(OSError):  # Not empty, or never made.
                folder.rmdir()


def unwritable(path: str | Path, error: OSError) -> InputError:
    """The one line for an `OSError` that came up while writing `path`."""
    return InputError(f"cannot write {path}: {error.strerror or error}")


def make_folder(path: str | Path) -> Path:
    """Creates a folder and its parents where absent.

    Raises:
        InputError: It cannot be created, or a file has its name.
    """
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(path, error) from error
    return Path(path)


def _is_about_another_file(error: OSError, temporary: Path, path: Path) -> bool:
    """Whether the block failed on a file of its own, or never wrote: not a fault of the target."""
    if error.filename is None:
        return False
    named = Path(os.fsdecode(error.filename))
    unwritten = isinstance(error, FileNotFoundError) and named == temporary and path.parent.is_dir()
    return unwritten or named not in (temporary, path, *path.parents)


def flush(path: Path) -> None:
    """Waits until the file's bytes (or the folder's list of names) are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
