"""Temporary files: hidden names for what is not whole yet, and arrays on the disk instead of in memory."""

import glob
import os
import re
import secrets
import shutil
import tempfile
import weakref
from collections.abc import Iterable
from pathlib import Path
from typing import IO

import numpy as np

from gsjax.errors import InputError

_NAMES = re.compile(r"\..*\.gsjax-(\d+)-[0-9a-f]{8}(\.[^.]*)?")
FILE = 1 << 30  # bytes of a file of arrays, which is mapped as a whole: few are open at a time
ALIGNED = 64  # bytes, as jax requires of arrays that it reads in place
_LONGEST = 40  # characters that are kept of a name, so that the temporary one is not too long


def temporary_beside(path: Path) -> Path:
    """A new name in the folder of `path`, with its suffix and with this process's number in it; nothing is made."""
    return path.with_name(f"{_beginning(path)}{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")


def behind_link(path: Path) -> Path:
    """Where a link leads, whether or not anything is there; any other path itself."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def is_temporary(path: Path) -> bool:
    """Whether a name is one that `temporary_beside` gives."""
    return _NAMES.fullmatch(path.name) is not None


def sweep(folder: str | Path) -> None:
    """Removes, in a folder and those under it, the temporary files of writers that were killed; no file of others."""
    _remove_left(path for path in Path(folder).rglob(".*") if path.is_file())


def sweep_beside(path: Path) -> None:
    """Remove temporary files and folders that killed writers of `path` have left in its folder, or where it leads."""
    path = behind_link(path)
    _remove_left(path.parent.glob(f"{glob.escape(_beginning(path))}*{glob.escape(path.suffix)}"))


def unwritable(path: str | Path, error: OSError) -> InputError:
    """The one line for an `OSError` that came up while writing `path`."""
    return InputError(f"cannot write {path}: {error.strerror or error}")


class ArraysOnDisk:
    """Stores arrays in files without a name, which the system removes when the process ends."""

    def __init__(self, folder: Path):
        """Files on the disk of `folder`, or of the nearest folder above it that is there."""
        self.folder = next(each for each in (folder, *folder.absolute().parents) if each.is_dir())
        self._file, self._mapped, self._taken = None, np.empty(0, np.uint8), 0

    def __call__(self, array: np.ndarray) -> np.ndarray:
        """The same array as it is on the disk, read only; one that is on a disk already is not copied."""
        if (isinstance(array, np.memmap) and array.mode is not None) or not array.nbytes:  # Copies have no mode.
            return array
        try:
            file = self._file_with_room(array.nbytes)
            begin = file.seek(self._taken)
            # Not stored through the map, where a full disk would kill the process.
            file.write(np.ascontiguousarray(array).data)
            file.flush()
        except OSError as error:
            raise unwritable(self.folder, error) from error
        self._taken = -(-(begin + array.nbytes) // ALIGNED) * ALIGNED
        return self._mapped[begin : begin + array.nbytes].view(array.dtype).reshape(array.shape)

    def _file_with_room(self, size: int) -> IO[bytes]:
        if self._file is None or self._taken + size > len(self._mapped):
            self._file = tempfile.TemporaryFile(dir=self.folder)  # noqa: SIM115 (closed with this object)
            weakref.finalize(self, self._file.close)
            self._file.truncate(max(FILE, size))  # Bytes that are never written take no space.
            self._mapped, self._taken = np.memmap(self._file, np.uint8, mode="r"), 0
        return self._file


def _beginning(path: Path) -> str:
    return f".{path.stem[:_LONGEST]}.gsjax-"


def _remove_left(paths: Iterable[Path]) -> None:
    """Removes those whose temporary name is that of a process that is no more."""
    for path in paths:
        if match := _NAMES.fullmatch(path.name):
            try:
                os.kill(int(match[1]), 0)
            except (ProcessLookupError, OverflowError):
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)
            except OSError:  # Another user's, which lives.
                continue
