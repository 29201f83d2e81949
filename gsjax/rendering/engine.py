"""Where jax computes here, and which engine the rasterizer draws with there."""

from typing import NamedTuple

from rasterizer.devices import default_device
from rasterizer.engines import choose


class Engine(NamedTuple):
    """What "auto" means on this machine."""

    name: str  # as `rasterizer.rasterization(backend=)` takes it
    device: str  # "the CPU", or the accelerator's name
    is_on_cpu: bool
    why: str  # why it is not the fastest engine for that device, in words; empty where it is


def engine_here() -> Engine:
    """Ask jax for its device and the rasterizer for its engine; the CPU's loops may be compiled for that.

    Raises:
        RuntimeError: Jax has no device of the kind that JAX_PLATFORMS names.
    """
    is_on_cpu = computes_on_cpu()
    name, reason = choose()
    return Engine(name, "the CPU" if is_on_cpu else default_device().device_kind, is_on_cpu, reason or "")


def computes_on_cpu() -> bool:
    """Whether the processor computes, and what is computed with is in its memory."""
    return default_device().platform == "cpu"
