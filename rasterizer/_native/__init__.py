"""The CPU's tile engine as native loops: numba compiles them, XLA calls them, no Python runs in between.

`blending` is the text of the blend and `ewa` that of the projection, `tiles` walks the list of a tile, `projection`,
`lists`, `passes`, `harmonics`, `similarity` and `updates` are what XLA calls, `calls` is how it calls and how threads
share the work, `engine` is the face to jax.
Importing this package compiles it all, or loads it; `rasterizer.engines` does so when the engine is first used.
"""

from rasterizer._native.compiled import disk_cache

with disk_cache():
    from rasterizer._native.engine import (
        ENGINE,
        adam,
        all_finite,
        project,
        project_gradient,
        ssim,
        ssim_gradient,
        upper_bands,
        upper_bands_gradient,
    )
    from rasterizer._native.harmonics import BANDS, CHANNELS
    from rasterizer._native.similarity import MAX_IMAGE_CHANNELS
    from rasterizer._native.tiles import MAX_SIDE

__all__ = [
    "BANDS",
    "CHANNELS",
    "ENGINE",
    "MAX_IMAGE_CHANNELS",
    "MAX_SIDE",
    "adam",
    "all_finite",
    "project",
    "project_gradient",
    "ssim",
    "ssim_gradient",
    "upper_bands",
    "upper_bands_gradient",
]
