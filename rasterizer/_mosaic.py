"""The kernels of `rasterizer._pallas` launched by Pallas' Mosaic GPU backend, for a jax without a Triton one.

A program is a warpgroup, 128 threads. What Mosaic cannot do is left to the xla engine: tiles of fewer pixels than that,
and channels that end in front, whose way back reads another splat for every pixel.
"""

from functools import cache
from typing import Any

import jax
from jax import Array

from rasterizer import _pallas, _xla
from rasterizer.compositing import Blended, Engine, Static

THREADS = 128


def launch(
    kernel, programs: int, shapes, warps: int, interpret: bool, arguments: tuple[Array, ...], zeros: Array | None = None
):
    """A `rasterizer._pallas.Launch`."""
    from jax.experimental.pallas import mosaic_gpu

    del warps
    mosaic: Any = mosaic_gpu  # An older jax's has not all that is used.
    params = mosaic.InterpretGPUParams() if interpret else None
    how = {"grid": (programs,), "grid_names": ("program",), "interpret": params}

    def body(*refs):
        kernel(jax.lax.axis_index("program"), *refs)

    if zeros is None:
        return mosaic.kernel(body, out_type=shapes, **how)(*arguments)
    buffer = jax.new_ref(zeros)
    mosaic.kernel(body, out_type=(), **how)(*arguments, buffer)
    return jax.freeze(buffer)


@cache
def engine(interpret: bool, segment_size: int = _pallas.SEGMENT, *, sum_rows=_pallas.atomic_sums) -> Engine:
    """As `rasterizer._pallas.engine`; interpreted, a tile of a few splats takes seconds."""
    kernels = _pallas.engine(interpret, segment_size, launch, sum_rows)

    def engine_of(static: Static) -> Engine:
        return _xla.ENGINE if static.front or static.grid.tile_size**2 < THREADS else kernels

    def forward(static: Static, *arguments: Any) -> Blended:
        return engine_of(static).forward(static, *arguments)

    def backward(static: Static, *arguments: Any) -> Array:
        return engine_of(static).backward(static, *arguments)

    return kernels._replace(forward=forward, backward=backward)
