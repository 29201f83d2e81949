"""The tile engine as two GPU kernels (Pallas, Triton backend). The only module that knows Pallas.

One program per tile walks the tile's list, one splat after the other: its numbers are scalars for the whole program,
its pixels a vector in registers. The backward kernel sums each pair's moments over the pixels and stores them; no
atomics. The blend is the text that the xla engine runs.
"""

from functools import cache, partial

import jax
import jax.numpy as jnp
from jax import Array
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton

from rasterizer.blending import blend_splat, cut_alpha, front_weight, splat_sigma, unblend_splat
from rasterizer.compositing import Blended, Engine, Static, chain_to_rows, moment_basis

CHUNK = 16  # Splats between two looks at whether every pixel has stopped: the look is a reduction over the program.
FORWARD_WARPS = 2
BACKWARD_WARPS = 1  # Reductions within one warp need no barrier.


def _pixels(static: Static) -> tuple[Array, Array]:
    """`compositing.pixel_centers`, computed inside the kernel: a kernel holds no constant arrays."""
    size = static.grid.tile_size
    index = jnp.arange(size * size, dtype=jnp.int32)
    middle = size / 2 - 0.5
    return (index % size).astype(jnp.float32) - middle, (index // size).astype(jnp.float32) - middle


def _center(tile: Array, static: Static) -> tuple[Array, Array]:
    """`compositing.tile_centers` of one tile, in scalars."""
    grid = static.grid
    within = tile % (grid.tiles_x * grid.tiles_y)
    x, y = within % grid.tiles_x, within // grid.tiles_x
    return ((x * grid.tile_size).astype(jnp.float32) + grid.tile_size / 2,
            (y * grid.tile_size).astype(jnp.float32) + grid.tile_size / 2)  # fmt: skip


def _offsets(rows, splat, pixels, center) -> tuple[Array, Array]:
    """`[P]` x and y of the splat's mean relative to the pixels."""
    return (rows[splat, 0] - center[0]) - pixels[0], (rows[splat, 1] - center[1]) - pixels[1]


def _alpha(rows, splat, dx, dy, rules) -> tuple[Array, Array]:
    """`[P]` alpha before the clamp, and as blended."""
    sigma = splat_sigma(dx, dy, rows[splat, 2], rows[splat, 3], rows[splat, 4])
    unclamped = rows[splat, 5] * jnp.exp(-sigma)
    return unclamped, cut_alpha(unclamped, sigma, rules)


def _forward_kernel(rows, splats, offsets, features, transmittance, last_index, *marks, static: Static):
    tile = pl.program_id(0)
    start, end = offsets[tile], offsets[tile + 1]
    pixels, center = _pixels(static), _center(tile, static)
    channels, front = features.shape[1], static.front
    first_in_front = channels - (front.channels if front else 0)

    def blend_one(k, state):
        signed_t, image, last, median = state
        splat = splats[k]
        _, alpha = _alpha(rows, splat, *_offsets(rows, splat, pixels, center), static.rules)
        weight, left = blend_splat(signed_t, alpha, static.rules)
        in_front = front_weight(signed_t, weight, front.stop_after) if front else weight
        weights = (weight,) * first_in_front + (in_front,) * (channels - first_in_front)
        image = tuple(c + w * rows[splat, 6 + i] for i, (c, w) in enumerate(zip(image, weights, strict=True)))
        last = jnp.where(weight > 0, k - start, last)
        if static.with_median:
            median = jnp.where((weight > 0) & (signed_t > 0.5), k - start, median)
        return left, image, last, median

    def blend_chunk(state):
        k, *pixel_state = state
        stop = jnp.minimum(k + CHUNK, end)
        return stop, *jax.lax.fori_loop(k, stop, blend_one, tuple(pixel_state))

    blank = jnp.zeros_like(pixels[0])
    nothing = jnp.full(blank.shape, -1, jnp.int32)
    state = start, blank + 1, (blank,) * channels, nothing, nothing if static.with_median else None
    _, signed_t, image, last, median = jax.lax.while_loop(
        lambda state: (state[0] < end) & (jnp.max(state[1]) > 0), blend_chunk, state
    )
    for i in range(channels):
        features[tile, i, :] = image[i]
    transmittance[tile, :] = jnp.abs(signed_t)
    last_index[tile, :] = last
    if static.with_median:
        marks[0][tile, :] = median


def _backward_kernel(
    rows,
    splats,
    offsets,
    transmittance,
    last_index,
    d_features,
    d_transmittance,
    zeros,
    gradients,
    *,
    static: Static,
):
    del zeros  # Aliased to the output.
    tile = pl.program_id(0)
    start = offsets[tile]
    pixels, center = _pixels(static), _center(tile, static)
    last = last_index[tile, :]
    channels, front = d_features.shape[1], static.front
    first_in_front = channels - (front.channels if front else 0)
    count = jnp.max(last) + 1

    def unblend_one(i, state):
        t, behind = state
        k = count - 1 - i
        splat = splats[start + k]
        dx, dy = _offsets(rows, splat, pixels, center)
        unclamped, alpha = _alpha(rows, splat, dx, dy, static.rules)
        alpha = jnp.where(k <= last, alpha, 0)
        lit = sum(rows[splat, 6 + c] * d_features[tile, c, :] for c in range(first_in_front))
        in_front = None
        if front:
            lit_in_front = sum(rows[splat, 6 + c] * d_features[tile, c, :] for c in range(first_in_front, channels))
            in_front = lit_in_front, front.stop_after
        d_sigma, weight, t, behind = unblend_splat(t, behind, lit, alpha, unclamped, static.rules, in_front)
        for column, power in enumerate(moment_basis(dx, dy)):
            gradients[start + k, column] = jnp.sum(d_sigma * power)
        counted_in_front = front_weight(t, weight, front.stop_after) if front else weight
        for c in range(channels):
            counted = weight if c < first_in_front else counted_in_front
            gradients[start + k, 6 + c] = jnp.sum(counted * d_features[tile, c, :])
        return t, behind

    t = transmittance[tile, :]
    jax.lax.fori_loop(0, count, unblend_one, (t, t * d_transmittance[tile, :]))


def _call(kernel, static: Static, shapes, warps: int, interpret: bool, **options):
    return pl.pallas_call(
        partial(kernel, static=static),
        out_shape=shapes,
        grid=(static.grid.num_tiles,),
        compiler_params=triton.CompilerParams(num_warps=warps, num_stages=1),
        interpret=interpret,
        **options,
    )


def _forward(static: Static, rows: Array, splats: Array, offsets: Array, *, interpret: bool) -> Blended:
    tiles, pixels, channels = static.grid.num_tiles, static.grid.tile_size**2, rows.shape[1] - 6
    indices = jax.ShapeDtypeStruct((tiles, pixels), jnp.int32)
    shapes = [
        jax.ShapeDtypeStruct((tiles, channels, pixels), jnp.float32),
        jax.ShapeDtypeStruct((tiles, pixels), jnp.float32),
        *[indices] * (1 + static.with_median),
    ]
    features, t, last, *marks = _call(_forward_kernel, static, shapes, FORWARD_WARPS, interpret)(rows, splats, offsets)
    return Blended(features, t, last, marks[0] if static.with_median else None)


def _backward(static: Static, rows, splats, offsets, t, last, d_features, d_t, *, interpret: bool) -> Array:
    # The kernel writes the pairs that some pixel saw; the rest stay the zeros that come in.
    zeros = jnp.zeros((splats.shape[0], rows.shape[1]), jnp.float32)
    shapes = jax.ShapeDtypeStruct(zeros.shape, zeros.dtype)
    kernel = _call(_backward_kernel, static, shapes, BACKWARD_WARPS, interpret, input_output_aliases={7: 0})
    gradients = kernel(rows, splats, offsets, t, last, d_features, d_t, zeros)
    d_rows = chain_to_rows(rows[splats], gradients[:, :6], gradients[:, 6:])
    used = jnp.arange(splats.shape[0], dtype=jnp.int32) < offsets[-1]
    return jnp.zeros_like(rows).at[splats].add(jnp.where(used[:, None], d_rows, 0))


@cache
def engine(interpret: bool) -> Engine:
    """The kernels, or, without a GPU, their interpretation: as slow as it is faithful."""
    return Engine(partial(_forward, interpret=interpret), partial(_backward, interpret=interpret))
