"""How the loops are compiled, and where the compiled code is kept.

It is kept on disk, in a folder named by the source of this package: the next process loads it, and another version of
the source never finds it.
"""

import hashlib
import logging
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba
from numba.core import config as _config

config: Any = _config  # Its fields are made when it is loaded.
# Sums may be contracted and reordered, so that loops become vectors; infinities and NaN keep their meaning.
FAST = {"contract", "reassoc", "nsz"}

logger = logging.getLogger("rasterizer")


def cache_folder() -> Path:
    """Where NUMBA_CACHE_DIR says, else beside the programs that XLA compiled."""
    if config.CACHE_DIR:
        return Path(config.CACHE_DIR)
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "gsjax" / "loops" / _source_hash()


def _source_hash() -> str:
    sources = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:16]


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def _has_code(folder: Path) -> bool:
    return any(folder.rglob("*.nbi"))


def _home_or_none() -> Path | None:
    try:
        folder = cache_folder()
    except RuntimeError:  # No home: compiled anew in every process.
        return None
    return folder if _is_writable(folder) else None


FOLDER = _home_or_none()
OPTIONS: dict[str, Any] = {"fastmath": FAST, "error_model": "numpy"}

# Compiled once, and inlined by LLVM wherever it is called. Nobody calls it from Python, which saves its wrappers.
INLINED = {"forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True, **OPTIONS}
inlined = numba.njit(**INLINED)


def entry_point(signature: object) -> Callable:
    """A function that C can call, compiled or loaded as soon as it is defined."""
    return numba.cfunc(signature, cache=FOLDER is not None, **OPTIONS)


@contextmanager
def kept_on_disk() -> Iterator[None]:
    """Functions that are defined within are kept in `FOLDER`. Says so where they are compiled for the first time."""
    before, started = config.CACHE_DIR, time.perf_counter()
    first = FOLDER is None or not _has_code(FOLDER)
    if first:
        logger.warning("compiling the rasterizer's loops for this processor, once ...")
    config.CACHE_DIR = str(FOLDER or "")
    try:
        yield
    finally:
        config.CACHE_DIR = before
    if first:
        where = f"kept in {FOLDER}" if FOLDER else "not kept, since the cache folder cannot be written"
        logger.warning("compiled in %.0f s, %s", time.perf_counter() - started, where)
