"""Where jax computes, and whether the GPU kernels run there."""

import os
import re
from typing import Any

import jax

LEAST_CAPABILITY = 8, 0  # Ampere: Pallas' Triton compiles for nothing older.

DETERMINISTIC = re.compile(r"--xla_gpu_deterministic_ops(=true|=1|\s|$)")

LEAST_JAX_OF_MOSAIC = 0, 12  # That of jax 0.11 compiles for Hopper alone.


def default_device() -> Any:
    """The `jax.Device` that is computed on unless an array says otherwise: `jax.default_device`'s, else the first."""
    config: Any = jax.config  # Its fields are made when it is loaded.
    default = config.jax_default_device
    if default is None or isinstance(default, str):
        return jax.local_devices(backend=default)[0]
    return default


def why_no_kernels(device: Any) -> str | None:
    """Why the GPU kernels do not run on a device; None where they do."""
    capability = str(getattr(device, "compute_capability", ""))  # "9.0"; of AMD's a name, such as "gfx90a"
    if not re.fullmatch(r"\d+\.\d+", capability):
        return f"its kernels are for NVIDIA's GPUs, and this is {device.device_kind}"
    least = ".".join(map(str, LEAST_CAPABILITY))
    if tuple(map(int, capability.split("."))) < LEAST_CAPABILITY:
        return f"its kernels need compute capability {least}, and {device.device_kind} has {capability}"
    if not has_triton() and not has_mosaic():
        return f"its kernels need Pallas' Triton or Mosaic backend, and jax {jax.__version__} has neither"
    return None


def has_triton() -> bool:
    """Whether jax has Pallas' Triton backend, which it calls deprecated since 0.11."""
    try:
        from jax.experimental.pallas import triton  # noqa: F401
    except ImportError:
        return False
    return True


def has_mosaic() -> bool:
    """Whether jax has a Mosaic GPU backend that compiles for all devices on which the kernels run."""
    try:
        from jax.experimental.pallas import mosaic_gpu
    except ImportError:
        return False
    return jax.__version_info__ >= LEAST_JAX_OF_MOSAIC and hasattr(mosaic_gpu, "InterpretGPUParams")


def wants_determinism() -> bool:
    """Whether XLA is configured, in XLA_FLAGS, for the same bits in every run: no sums by a GPU's atomics."""
    return DETERMINISTIC.search(os.environ.get("XLA_FLAGS", "")) is not None
