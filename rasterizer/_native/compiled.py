"""How the loops are compiled, where the compiled code is kept, and how XLA and its threads find it.

It is kept on disk, in a folder named by the source of this package and by numba's version: processes of any environment
load it, wherever the package lies, and another version never finds it.
"""

import hashlib
import logging
import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numba
from numba import types
from numba.core import config as _config
from numba.core.caching import UserProvidedCacheLocator

config: Any = _config  # Its fields are made when it is loaded.
# Sums may be contracted and reordered, so that loops become vectors; infinities and NaN keep their meaning.
FAST = {"contract", "reassoc", "nsz"}
API_MAJOR, API_MINOR = 0, 3  # of XLA's interface, as `calls` is written for it

logger = logging.getLogger("rasterizer")


def _check_interface() -> None:
    """Raises ImportError where XLA's interface has changed since `calls` was written."""
    header = (Path(jax.ffi.include_dir()) / "xla" / "ffi" / "api" / "c_api.h").read_text()
    version = [int(re.findall(rf"define XLA_FFI_API_{part} (\d+)", header)[0]) for part in ("MAJOR", "MINOR")]
    if version[0] != API_MAJOR or version[1] < API_MINOR:
        raise ImportError(f"XLA's FFI is of version {version[0]}.{version[1]}, not {API_MAJOR}.{API_MINOR} or later")


_check_interface()


class ByContent(UserProvidedCacheLocator):
    """Finds a function by the name of `FOLDER`; numba's own locators depend on the path of the source as well."""

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(FOLDER)

    def get_source_stamp(self) -> str:
        """Return what decides whether the source has changed: nothing, as `FOLDER` would have another name."""
        return ""


def _writable_folder() -> Path | None:
    """The folder of this version, in the one that NUMBA_CACHE_DIR names, else next to the programs of XLA.

    None where there is no home or it cannot be written: every process compiles anew.
    """
    sources = [path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py"))]
    version = hashlib.sha256(b"".join([numba.__version__.encode(), *sources])).hexdigest()[:16]
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gsjax" / "loops"
        folder = (Path(config.CACHE_DIR) if config.CACHE_DIR else home) / version
        folder.mkdir(parents=True, exist_ok=True)
    except (RuntimeError, OSError):
        return None
    return folder if os.access(folder, os.W_OK) else None


FOLDER = _writable_folder()
OPTIONS: dict[str, Any] = {"fastmath": FAST, "error_model": "numpy"}
INLINED: dict[str, Any] = {"forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True, **OPTIONS}

# Compiled once, and inlined by LLVM wherever it is called. Python never calls it, which saves its wrappers.
inlined = numba.njit(**INLINED)


def handler(function: Any) -> Any:
    """A call of XLA's by the function's name: from the address of its frame to 0, or to the address of an error."""
    compiled: Any = numba.cfunc(types.int64(types.int64), cache=FOLDER is not None, **OPTIONS)(function)
    jax.ffi.register_ffi_target(f"rasterizer_{function.__name__}", jax.ffi.pycapsule(compiled.ctypes), platform="cpu")
    return compiled


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
