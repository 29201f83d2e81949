"""What the command line settles for jax before it is imported; the library itself never touches the environment."""

import ctypes
import logging
import os
import re
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gsjax.errors import InputError
from gsjax.io.machine import cpu_flags

VECTOR_WIDTH = "--xla_cpu_prefer_vector_width"
AUTOTUNING = "--xla_gpu_autotune_level"
DETERMINISTIC = "--xla_gpu_deterministic_ops"
CUDA_PLUGINS = "jax_cuda12_plugin", "jax_cuda13_plugin"
DAMAGED = re.compile(r"Error reading persistent compilation cache entry for '(.+?)': ")
PLUGIN_FAULT = "Jax plugin configuration error"
PROGRAM = re.compile(r"-[0-9a-f]+-(cache|atime)$")  # After a program's name, as jax calls the files of its cache.
# mallopt of glibc: one arena, no block mapped by itself, nothing given back while the process lives.
KEEP_MEMORY = {-8: 1, -3: 1 << 30, -1: (1 << 31) - 1}


def require_unix() -> None:
    """Raises InputError on Windows itself, which has neither the file locks nor the process limits that are used."""
    if sys.platform == "win32":
        raise InputError("Windows itself is not supported; gsjax runs there in WSL2: https://aka.ms/wsl")


def is_called_nowhere() -> bool:
    """Whether the working folder has been removed, so that no relative path leads anywhere."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return True
    return False


def prepare() -> None:
    """Full-width vectors where the CPU has them, memory that is kept, a compilation cache that outlives the process.

    And of a GPU's memory what is used, where jax would take three quarters at its start. What the user has set in
    XLA_FLAGS, XLA_PYTHON_CLIENT_PREALLOCATE, JAX_COMPILATION_CACHE_DIR or glibc's MALLOC_ variables stays.
    """
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    flags = os.environ.get("XLA_FLAGS", "")
    # XLA prefers 256 bits by default; with 512 the rasterizer's forward pass ran 1.3-2x faster (AMD EPYC, jax 0.10.2).
    if VECTOR_WIDTH not in flags and "avx512f" in cpu_flags():
        flags += f" {VECTOR_WIDTH}=512"
    # XLA compiles every fused loop for a GPU twice to choose how; a training step compiles in half the time without.
    if AUTOTUNING not in flags and any(map(find_spec, CUDA_PLUGINS)):
        flags += f" {AUTOTUNING}=0"
    if flags:
        os.environ["XLA_FLAGS"] = flags.strip()
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        with suppress(OSError, RuntimeError):  # No home or no room: compiling anew each time is only slower.
            folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gsjax" / "xla"
            folder.mkdir(parents=True, exist_ok=True)
            os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
    keep_memory()
    replace_damaged_programs()
    logging.getLogger("jax._src.xla_bridge").addFilter(plugin_fault_in_one_line)


def ask_for_determinism() -> None:
    """Has XLA, and the rasterizer with it, add in the same order in every run on a GPU; before anything is computed."""
    flags = [flag for flag in os.environ.get("XLA_FLAGS", "").split() if not flag.startswith(DETERMINISTIC)]
    os.environ["XLA_FLAGS"] = " ".join([*flags, f"{DETERMINISTIC}=true"])


def plugin_fault_in_one_line(record: logging.LogRecord) -> bool:
    """A filter of jax's log: of a plugin that does not load, such as CUDA's without a driver, the traceback goes."""
    if str(record.msg).startswith(PLUGIN_FAULT):
        error = record.exc_info[1] if record.exc_info else None
        why = str(error).partition("\n")[0] if error else record.getMessage()
        record.msg, record.args = f"gsjax: jax goes on without a plugin that does not load here: {why}", ()
        record.exc_info = record.exc_text = None
    return True


def replace_damaged_programs() -> None:
    """Takes damaged programs out of the compilation cache as jax meets them, so that they are written anew.

    Jax warns of one and compiles the program, but never writes over a file that is there: at every start for ever.
    """
    if getattr(warnings.showwarning, "func", None) is not _show_or_replace:
        warnings.showwarning = partial(_show_or_replace, warnings.showwarning)


def _show_or_replace(show: Callable[..., None], message: Warning | str, *about: Any, **more: Any) -> None:
    damaged = DAMAGED.match(str(message))
    folder = Path(os.environ.get("JAX_COMPILATION_CACHE_DIR", ""))
    if damaged is None or not folder.is_absolute():
        show(message, *about, **more)
        return
    with suppress(OSError):  # Of another user's: it stays damaged, and is only slower.
        for file in folder.iterdir():
            if PROGRAM.sub("", file.name) == damaged[1]:
                file.unlink(missing_ok=True)


def keep_memory() -> None:
    """Lets glibc's allocator keep what it has. A step would else map its buffers anew, page by page."""
    if any(name.startswith("MALLOC_") for name in os.environ):
        return
    with suppress(AttributeError, OSError):  # Another system's allocator.
        mallopt = ctypes.CDLL(None).mallopt
        for option, value in KEEP_MEMORY.items():
            mallopt(option, value)
