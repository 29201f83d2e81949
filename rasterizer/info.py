"""Intermediate results of `rasterization`: arrays that it has anyway, and gsplat's other keys, derived when read."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from rasterizer.binning import TileGrid


@jax.tree_util.register_pytree_with_keys_class
class Info(Mapping[str, Any]):
    """Intermediate results by name. A pytree of the stored arrays; what is derived from them costs nothing unread."""

    def __init__(self, arrays: dict[str, Any], grid: TileGrid):
        """Hold the arrays of one call, and its tiles."""
        self._arrays, self._grid = arrays, grid

    def __getitem__(self, name: str) -> Any:
        if name in self._arrays:
            return self._arrays[name]
        return self._derived()[name](self._arrays, self._grid)

    def __iter__(self) -> Iterator[str]:
        return iter((*self._arrays, *self._derived()))

    def __len__(self) -> int:
        return len(self._arrays) + len(self._derived())

    def __repr__(self) -> str:
        return f"Info({', '.join(self)})"

    def _derived(self) -> dict[str, Callable[[dict[str, Any], TileGrid], Any]]:
        return OF_SIZES | OF_LISTS if "splats" in self._arrays else OF_SIZES

    def tree_flatten_with_keys(self):
        """The stored arrays are the children."""
        names = tuple(sorted(self._arrays))
        return [(jax.tree_util.DictKey(name), self._arrays[name]) for name in names], (names, self._grid)

    @classmethod
    def tree_unflatten(cls, static, children):
        """Inverse of `tree_flatten_with_keys`."""
        names, grid = static
        return cls(dict(zip(names, children, strict=True)), grid)


def _flatten_ids(arrays: dict[str, Array], _: TileGrid) -> Array:
    """`[..., capacity]` int32 listed splats c * N + n, by tile and depth; -1 in slots left over."""
    splats, count = arrays["splats"], arrays["offsets"][..., -1:]
    return jnp.where(jax.lax.broadcasted_iota(jnp.int32, splats.shape, splats.ndim - 1) < count, splats, -1)


def _isect_offsets(arrays: dict[str, Array], grid: TileGrid) -> Array:
    """`[..., C, tile_height, tile_width]` int32: where each tile's run begins in `flatten_ids`."""
    first = arrays["offsets"][..., :-1]
    return first.reshape(*first.shape[:-1], grid.num_cameras, grid.tiles_y, grid.tiles_x)


def _tiles_per_gauss(arrays: dict[str, Array], grid: TileGrid) -> Array:
    """`[..., C, N]` int32: in how many tiles each splat is listed."""
    listed, shape = _flatten_ids(arrays, grid), arrays["depths"].shape

    def count(listed: Array) -> Array:
        size = shape[-2] * shape[-1]
        return jnp.zeros(size, jnp.int32).at[jnp.where(listed >= 0, listed, size)].add(1, mode="drop")

    return jax.vmap(count)(listed.reshape(-1, listed.shape[-1])).reshape(shape)


OF_SIZES = {
    "width": lambda _, grid: grid.width,
    "height": lambda _, grid: grid.height,
    "n_cameras": lambda _, grid: grid.num_cameras,
    "tile_size": lambda _, grid: grid.tile_size,
    "tile_width": lambda _, grid: grid.tiles_x,
    "tile_height": lambda _, grid: grid.tiles_y,
    "camera_ids": lambda _, __: None,  # No rows are packed: gsplat has None, too.
    "gaussian_ids": lambda _, __: None,
}
OF_LISTS = {"tiles_per_gauss": _tiles_per_gauss, "isect_offsets": _isect_offsets, "flatten_ids": _flatten_ids}
