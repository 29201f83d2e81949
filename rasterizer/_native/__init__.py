"""The tile engine as native loops: the CPU's. numba compiles them, XLA calls them, Python is not there while they run.

`blending` is the text of the blend, `tiles` walks a tile's list, `passes` and `lists` are what XLA calls, `calls` how it
does and how threads share the work, `engine` the face to jax. Importing this package compiles or loads it all;
`rasterizer.engines` does so when the engine is first used.
"""

from rasterizer._native.compiled import kept_on_disk

with kept_on_disk():
    from rasterizer._native.engine import ENGINE
    from rasterizer._native.tiles import MAX_SIDE

__all__ = ["ENGINE", "MAX_SIDE"]
