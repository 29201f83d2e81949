"""The CPU's tile engine as native loops: numba compiles them, XLA calls them, no Python runs in between.

`blending` is the text of the blend and `ewa` that of the projection, `tiles` walks the list of a tile, `projection`,
`lists`, `passes`, `harmonics`, `similarity` and `updates` are what XLA calls, `calls` is how it calls and how threads
share the work, `engine` is the face to jax.
Importing this package compiles it all, or loads it; `rasterizer.engines` does so when the engine is first used.
"""

from rasterizer._native.compiled import disk_cache

with disk_cache():
    from rasterizer._native import engine, harmonics, lists, passes, projection, similarity, updates

__all__ = ["engine", "harmonics", "lists", "passes", "projection", "similarity", "updates"]
