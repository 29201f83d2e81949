"""How the loops are compiled, and where the compiled code is kept.

It is kept on disk, in a folder named by the source of this package and by numba's version: processes of any environment
load it, wherever the package lies, and another version never finds it.
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
from numba.core.caching import UserProvidedCacheLocator

config: Any = _config  # Its fields are made when it is loaded.
# Sums may be contracted and reordered, so that loops become vectors; infinities and NaN keep their meaning.
FAST = {"contract", "reassoc", "nsz"}

logger = logging.getLogger("rasterizer")


def cache_folder() -> Path:
    """The folder of this version, in the one that NUMBA_CACHE_DIR names, else next to the programs of XLA."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gsjax" / "loops"
    return (Path(config.CACHE_DIR) if config.CACHE_DIR else home) / _version_hash()


def _version_hash() -> str:
    sources = [path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py"))]
    return hashlib.sha256(b"".join([numba.__version__.encode(), *sources])).hexdigest()[:16]


class ByContent(UserProvidedCacheLocator):
    """Finds a function by the name of `FOLDER`; numba's own locators depend on the path of the source as well."""

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(FOLDER)

    def get_source_stamp(self) -> str:
        """Return what decides whether the source has changed: nothing, as `FOLDER` would have another name."""
        return ""


def _writable_folder() -> Path | None:
    """The cache folder; None where there is no home or it cannot be written: every process compiles anew."""
    try:
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
    except (RuntimeError, OSError):
        return None
    return folder if os.access(folder, os.W_OK) else None


FOLDER = _writable_folder()
OPTIONS: dict[str, Any] = {"fastmath": FAST, "error_model": "numpy"}

# Compiled once, and inlined by LLVM wherever it is called. Python never calls it, which saves its wrappers.
INLINED = {"forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True, **OPTIONS}
inlined = numba.njit(**INLINED)


def entry_point(signature: object) -> Callable:
    """A function that C can call, compiled or loaded as soon as it is defined."""
    return numba.cfunc(signature, cache=FOLDER is not None, **OPTIONS)


@contextmanager
def disk_cache() -> Iterator[None]:
    """Functions that are defined within are stored in `FOLDER`. Logs when they are compiled for the first time."""
    before, started = (config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES), time.perf_counter()
    is_first = FOLDER is None or not any(FOLDER.rglob("*.nbi"))
    if is_first:
        logger.warning("compiling the rasterizer's loops for this processor, once ...")
    config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = str(FOLDER or ""), f"{__name__}.{ByContent.__name__}"
    try:
        yield
    finally:
        config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = before
    if is_first:
        where = f"kept in {FOLDER}" if FOLDER else "not kept, since the cache folder cannot be written"
        logger.warning("compiled in %.0f s, %s", time.perf_counter() - started, where)
