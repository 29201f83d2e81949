"""The environment that the command line sets up for jax before it is imported. The library itself never changes it."""

import ctypes
import logging
import os
import sys
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

from gsjax.errors import InputError
from gsjax.io.machine import cpu_flags

VECTOR_WIDTH = "--xla_cpu_prefer_vector_width"
AUTOTUNING = "--xla_gpu_autotune_level"
DETERMINISTIC = "--xla_gpu_deterministic_ops"
CUDA_PLUGINS = "jax_cuda12_plugin", "jax_cuda13_plugin"
PLUGIN_FAULT = "Jax plugin configuration error"
# mallopt of glibc: one arena, no block mapped by itself, nothing given back while the process lives.
KEEP_MEMORY = {-8: 1, -3: 1 << 30, -1: (1 << 31) - 1}


def require_unix() -> None:
    """Raise InputError on Windows itself, which lacks the file locks and process limits that gsjax uses."""
    if sys.platform == "win32":
        raise InputError("Windows itself is not supported; gsjax runs there in WSL2: https://aka.ms/wsl")


def prepare() -> None:
    """Set XLA's flags, the memory allocators and the compilation cache.

    A GPU's memory is allocated as it is used, where jax would allocate three quarters at its start. The user's own
    XLA_FLAGS, XLA_PYTHON_CLIENT_PREALLOCATE, JAX_COMPILATION_CACHE_DIR and MALLOC_ variables stay.
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
    logging.getLogger("jax._src.xla_bridge").addFilter(plugin_fault_in_one_line)


def ask_for_determinism() -> None:
    """Has XLA, and the rasterizer with it, add in the same order in every run on a GPU; before anything is computed."""
    flags = [flag for flag in os.environ.get("XLA_FLAGS", "").split() if not flag.startswith(DETERMINISTIC)]
    os.environ["XLA_FLAGS"] = " ".join([*flags, f"{DETERMINISTIC}=true"])


def plugin_fault_in_one_line(record: logging.LogRecord) -> bool:
    """Filter jax's log: a plugin that does not load, such as CUDA's without a driver, is one line, not a traceback."""
    if str(record.msg).startswith(PLUGIN_FAULT):
        error = record.exc_info[1] if record.exc_info else None
        reason = str(error).partition("\n")[0] if error else record.getMessage()
        record.msg, record.args = f"gsjax: jax continues without a plugin that does not load: {reason}", ()
        record.exc_info = record.exc_text = None
    return True


def keep_memory() -> None:
    """Let glibc's allocator keep freed memory. Mapping the buffers again would add 11 % to a step."""
    if any(name.startswith("MALLOC_") for name in os.environ):
        return
    with suppress(AttributeError, OSError):  # Other allocators have no `mallopt`.
        mallopt = ctypes.CDLL(None).mallopt
        for option, value in KEEP_MEMORY.items():
            mallopt(option, value)
