"""Where jax computes here, and which engine the rasterizer draws with there."""

import logging
from typing import NamedTuple

from rasterizer.devices import default_device
from rasterizer.engines import resolve


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
    device = default_device()
    is_on_cpu = computes_on_cpu()
    heard = _Heard()
    logging.getLogger("rasterizer").addHandler(heard)
    try:
        name = resolve("auto")
    finally:
        logging.getLogger("rasterizer").removeHandler(heard)
    is_best = name == ("native" if is_on_cpu else "pallas")
    why = "" if is_best else (heard.lines or ["it is not the fastest one"])[0]
    return Engine(name, "the CPU" if is_on_cpu else device.device_kind, is_on_cpu, why)


class _Heard(logging.Handler):
    """Keeps what the rasterizer says of its choice."""

    def __init__(self):
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


def computes_on_cpu() -> bool:
    """Whether the processor computes, and what is computed with is in its memory."""
    return default_device().platform == "cpu"
