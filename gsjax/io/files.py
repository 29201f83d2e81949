"""Writing so that a target is either the old whole or the new whole, never a half."""

import os
import re
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gsjax.errors import InputError

_TEMPORARY = re.compile(r"\..*-[0-9a-f]{8}(\.\w+)?")  # As `atomic_path` names them.


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
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{path.suffix}")
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

    After a failure nothing of the block remains.

    Args:
        path: Where the whole folder is to be; absent or empty so far.

    Yields:
        The folder to write to.

    Raises:
        InputError: `path` is in use, or the disk is full, read-only, or the like.
    """
    path = Path(path)
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"{path}: exists and is not empty; choose another folder")
    make_folder(path.parent)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent) as workspace:
            folder = make_folder(Path(workspace) / path.name)
            yield folder
            os.replace(folder, path)
    except OSError as error:
        raise unwritable(path, error) from error


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


def sweep(folder: str | Path) -> None:
    """Removes, in a folder and those under it, the temporary files of writers that were killed."""
    for path in Path(folder).rglob(".*"):
        if _TEMPORARY.fullmatch(path.name) and path.is_file():
            path.unlink(missing_ok=True)


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
