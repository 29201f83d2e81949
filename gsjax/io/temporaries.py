"""Names of what is not whole yet: hidden, beside what is to be, and known as ours should its writer be killed."""

import glob
import os
import re
import secrets
import shutil
from pathlib import Path

_NAMES = re.compile(r"\..*\.gsjax-(\d+)-[0-9a-f]{8}(\.[^.]*)?")
_LONGEST = 40  # characters that are kept of a name, so that the temporary one is not too long


def temporary_beside(path: Path) -> Path:
    """A new name beside `path`, with its suffix and with this process's number in it; nothing is made."""
    return path.with_name(f"{_beginning(path)}{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")


def behind_link(path: Path) -> Path:
    """Where a link leads, whether or not anything is there; any other path itself."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def is_temporary(path: Path) -> bool:
    """Whether a name is one that `temporary_beside` gives."""
    return _NAMES.fullmatch(path.name) is not None


def sweep(folder: str | Path) -> None:
    """Removes, in a folder and those under it, the temporary files of writers that were killed; no file of others."""
    for path in Path(folder).rglob(".*"):
        if _is_left(path) and path.is_file():
            path.unlink(missing_ok=True)


def sweep_beside(path: Path) -> None:
    """Removes the temporary files and folders that killed writers of `path` have left beside it, or where it leads."""
    path = behind_link(path)
    for left in path.parent.glob(f"{glob.escape(_beginning(path))}*{glob.escape(path.suffix)}"):
        if not _is_left(left):
            continue
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left, ignore_errors=True)
        else:
            left.unlink(missing_ok=True)


def _beginning(path: Path) -> str:
    return f".{path.stem[:_LONGEST]}.gsjax-"


def _is_left(path: Path) -> bool:
    """Whether a temporary name is that of a process that is no more."""
    match = _NAMES.fullmatch(path.name)
    if not match:
        return False
    try:
        os.kill(int(match[1]), 0)
    except (ProcessLookupError, OverflowError):
        return True
    except OSError:  # Another user's, which lives.
        return False
    return False
