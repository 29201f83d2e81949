"""Which splats touch which tile, front to back: sorted lists of (tile, splat) pairs at a fixed capacity."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Int32

from rasterizer.ewa import Projection
from rasterizer.rules import Rules


class TileGrid(NamedTuple):
    """Square tiles over the images of C cameras, counted camera by camera, row by row. Hashable, static."""

    num_cameras: int
    width: int
    height: int
    tile_size: int

    @property
    def tiles_x(self) -> int:
        """Tiles per row."""
        return -(-self.width // self.tile_size)

    @property
    def tiles_y(self) -> int:
        """Rows of tiles."""
        return -(-self.height // self.tile_size)

    @property
    def num_tiles(self) -> int:
        """Tiles of all cameras together."""
        return self.num_cameras * self.tiles_x * self.tiles_y


class TilePairs(NamedTuple):
    """Sorted (tile, splat) pairs. Splats of camera c are numbered c * N + n."""

    splats: Int32[Array, "capacity"]  # by tile and, within a tile, by depth; rubbish past offsets[-1]
    offsets: Int32[Array, "num_offsets"]  # num_tiles + 1 of them: the range of each tile in `splats`
    needed: Int32[Array, ""]  # capacity without which pairs are lost
    overflowed: Bool[Array, ""]  # needed > capacity: the lists are incomplete and an image made of them is wrong


def _tile_boxes(projection: Projection, grid: TileGrid) -> tuple[Array, Array]:
    """`[C * N, 2]` first tile and number of tiles (x, y) that each splat's extent overlaps."""
    limit = jnp.array([[grid.tiles_x, grid.tiles_y]], jnp.int32)
    means, extents = (jax.lax.stop_gradient(x).reshape(-1, 2) for x in (projection.means2d, projection.extents))
    # Clipped before the cast: a far-off mean would not fit an integer.
    low = jnp.clip(jnp.floor((means - extents) / grid.tile_size), 0, limit.astype(means.dtype)).astype(jnp.int32)
    high = jnp.clip(jnp.floor((means + extents) / grid.tile_size) + 1, 0, limit.astype(means.dtype)).astype(jnp.int32)
    return low, jnp.where(projection.visible.reshape(-1, 1), high - low, 0)


def _total(count: Array) -> Array:
    """`[]` int32 sum, or the largest int32 where the sum does not fit: a sum that wrapped round would look small."""
    fits = jnp.sum(count.astype(jnp.float32)) < 2.0**31 * 0.99
    return jnp.where(fits, jnp.sum(count, dtype=jnp.int32), np.iinfo(np.int32).max)


def count_pairs(projection: Projection, grid: TileGrid) -> Int32[Array, ""]:
    """The capacity that `bin_splats` needs for this projection; the largest int32 if more."""
    _, size = _tile_boxes(projection, grid)
    return _total(size[:, 0] * size[:, 1])


def _depth_order(depths: Array, visible: Array) -> Array:
    """`[M]` int32 splats front to back; of equal depth, by their number."""
    bits = jax.lax.bitcast_convert_type(jnp.where(visible, depths, jnp.inf).astype(jnp.float32), jnp.uint32)
    return jax.lax.platform_dependent(bits, cpu=_order_on_cpu, default=_order)


def _order(keys: Array) -> Array:
    """`[M]` int32 places of rising uint32 keys. A GPU's radix sort passes once over every byte of a key."""
    return jax.lax.sort((keys, jnp.arange(keys.shape[0], dtype=jnp.int32)), num_keys=1, is_stable=True)[1]


def _order_on_cpu(keys: Array) -> Array:
    """`_order`, faster."""
    return _sort_on_cpu(keys, jnp.arange(keys.shape[0], dtype=jnp.int32))[1]


def _sort_on_cpu(keys: Array, values: Array) -> tuple[Array, Array]:
    """Pairs in rising order, by one packed integer key: XLA's CPU sort is 6-10x slower on a pair."""
    with jax.enable_x64(True):
        packed = jnp.sort((keys.astype(jnp.uint64) << np.uint64(32)) | values.astype(jnp.uint64))
        return (packed >> np.uint64(32)).astype(jnp.int32), (packed & np.uint64(0xFFFFFFFF)).astype(jnp.int32)


def _lists(tiles: Array, ranks: Array, num_tiles: int) -> tuple[Array, Array]:
    """Ranks by tile and, within a tile, rising, and `[num_tiles + 1]` offsets; tile `num_tiles` is left over.

    The ranks come in rising.
    """
    # As few bytes as hold a tile's number, see `_order`.
    key = jnp.uint16 if num_tiles < 1 << 16 else jnp.int32
    tiles, ranks = jax.lax.sort((tiles.astype(key), ranks), num_keys=1, is_stable=True)
    first = jnp.arange(num_tiles + 1, dtype=jnp.int32)
    # Unrolled: as a loop it would be 24 launches of a kernel, one after the other.
    return ranks, jnp.searchsorted(tiles.astype(jnp.int32), first, method="scan_unrolled").astype(jnp.int32)


def _lists_on_cpu(tiles: Array, ranks: Array, num_tiles: int) -> tuple[Array, Array]:
    """`_lists` by two sorts of one packed integer each, which run side by side on two cores.

    In every tile, the pairs of the nearer half of the slots come before those of the farther half: the halves are
    merged by counting.
    """

    def sort(tiles, ranks):
        tiles, ranks = _sort_on_cpu(tiles, ranks)
        return tiles, ranks, jnp.searchsorted(tiles, jnp.arange(num_tiles + 2, dtype=jnp.int32)).astype(jnp.int32)

    capacity, half = tiles.shape[0], tiles.shape[0] // 2
    near_tiles, near_ranks, near_starts = sort(tiles[:half], ranks[:half])
    far_tiles, far_ranks, far_starts = sort(tiles[half:], ranks[half:])
    near_place = jnp.arange(half, dtype=jnp.int32) + far_starts[near_tiles]
    far_place = jnp.arange(capacity - half, dtype=jnp.int32) + near_starts[far_tiles + 1]
    lists = jnp.zeros(capacity, jnp.int32)
    lists = lists.at[jnp.where(near_tiles < num_tiles, near_place, capacity)].set(near_ranks, mode="drop")
    lists = lists.at[jnp.where(far_tiles < num_tiles, far_place, capacity)].set(far_ranks, mode="drop")
    return lists, (near_starts + far_starts)[:-1]


def _least_sigma(offset_low: Array, offset_high: Array, conic: Array) -> Array:
    """Least Mahalanobis term sigma = d^T C d / 2 over a box of offsets from the splat's centre.

    Outside an axis' range the nearest edge is a candidate, with the best point along it in closed form.
    """
    nearest = jnp.clip(jnp.zeros_like(offset_low), offset_low, offset_high)
    a, b, c = conic[0], conic[1], conic[2]
    along_y = jnp.clip(-b / c * nearest[0], offset_low[1], offset_high[1])
    along_x = jnp.clip(-b / a * nearest[1], offset_low[0], offset_high[0])

    def sigma(x, y):
        return 0.5 * (a * x * x + c * y * y) + b * x * y

    edge_x = jnp.where(nearest[0] != 0, sigma(nearest[0], along_y), jnp.inf)
    edge_y = jnp.where(nearest[1] != 0, sigma(along_x, nearest[1]), jnp.inf)
    return jnp.where((nearest == 0).all(), 0, jnp.minimum(edge_x, edge_y))


def sigma_cuts(opacities: Array, rules: Rules) -> Array:
    """The Mahalanobis term up to which a splat is listed; a margin for rounding: a pair too many is harmless."""
    if rules.alpha_min <= 0:
        return jnp.full_like(opacities, jnp.inf)
    return jnp.log(jnp.maximum(opacities / rules.alpha_min, 1)) * 1.0001 + 1e-4


def bin_splats(
    projection: Projection,
    opacities: Array,
    grid: TileGrid,
    capacity: int,
    rules: Rules,
    masks: Array | None = None,
) -> TilePairs:
    """`rasterizer.bin_splats` in jnp.

    Depth-sorts the splats once, expands each into the tiles of its extent in that order, drops the tiles that its
    ellipse misses (exactly), and sorts once by tile. No array is larger than splats + capacity + tiles.
    """
    visible = projection.visible.reshape(-1)
    if visible.shape[0] == 0:
        return TilePairs(
            jnp.zeros(capacity, jnp.int32), jnp.zeros(grid.num_tiles + 1, jnp.int32), jnp.int32(0), jnp.array(False)
        )
    order = _depth_order(jax.lax.stop_gradient(projection.depths).reshape(-1), visible)
    low, size = (x[order] for x in _tile_boxes(projection, grid))
    # Rows of tiles are counted through all cameras: a box says by itself which camera it is of.
    first_row = order // (visible.shape[0] // grid.num_cameras) * grid.tiles_y
    rank, tile_x, row = expand_boxes(low.at[:, 1].add(first_row), size, capacity)
    needed, tile = _total(size[:, 0] * size[:, 1]), row * grid.tiles_x + tile_x
    splat = _ellipses(projection, opacities, rules)[order][rank]
    first_pixel = jnp.stack([tile_x, jax.lax.rem(row, jnp.int32(grid.tiles_y))], -1) * grid.tile_size
    offset_low = first_pixel.astype(splat.dtype) + 0.5 - splat[:, :2]
    sigma = jax.vmap(_least_sigma)(offset_low, offset_low + (grid.tile_size - 1), splat[:, 2:5])
    listed = (jnp.arange(capacity, dtype=jnp.int32) < needed) & (sigma <= splat[:, 5])
    if masks is not None:
        listed &= masks.reshape(-1)[jnp.minimum(tile, grid.num_tiles - 1)]
    how = {"num_tiles": grid.num_tiles}
    lists = partial(jax.lax.platform_dependent, cpu=partial(_lists_on_cpu, **how), default=partial(_lists, **how))
    rank, offsets = lists(jnp.where(listed, tile, grid.num_tiles), rank)
    return TilePairs(order[rank], offsets, needed, needed > capacity)


def expand_boxes(low: Array, size: Array, capacity: int) -> tuple[Array, Array, Array]:
    """The tiles of `[M, 2]` boxes, row by row and one box after the other, in a number of slots.

    Returns:
        `[capacity]` int32 each: the box of a slot, and x and y of its tile; rubbish in slots past the last tile.
    """
    count = size[:, 0] * size[:, 1]
    start = jnp.cumsum(count, dtype=jnp.int32) - count
    boxes = jnp.repeat(jnp.arange(count.shape[0], dtype=jnp.int32), count, total_repeat_length=capacity)
    # Everything that a slot needs in one gather.
    box = jnp.stack([low[:, 0], low[:, 1], jnp.maximum(size[:, 0], 1), start], -1)[boxes]
    index = jnp.arange(capacity, dtype=jnp.int32) - box[:, 3]
    # Half a tile is added so that rounding cannot reach the next integer: exact, and vectorised where // is not.
    row = jnp.floor((index.astype(jnp.float32) + 0.5) / box[:, 2].astype(jnp.float32)).astype(jnp.int32)
    return boxes, box[:, 0] + index - row * box[:, 2], box[:, 1] + row


def _ellipses(projection: Projection, opacities: Array, rules: Rules) -> Array:
    """`[C * N, 6]` mean, conic and `sigma_cuts` of every splat."""
    opacities = jnp.broadcast_to(opacities, projection.depths.shape)
    parts = projection.means2d, projection.conics, sigma_cuts(opacities, rules)[..., None]
    return jax.lax.stop_gradient(jnp.concatenate(parts, -1)).reshape(-1, 6)
