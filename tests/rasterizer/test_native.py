"""The native loops: their text against the first text of the blend, their lists and bits, and how XLA calls them."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import types
from numba.core import cgutils
from scenes import binned, cloud, stacks
from tolerances import assert_close

from rasterizer import (
    GSPLAT,
    INRIA,
    Front,
    TileGrid,
    blend,
    blending,
    rasterize_to_pixels,
)
from rasterizer._native import blending as native
from rasterizer._native import compiled
from rasterizer._native.instructions import as_floats, intrinsic
from rasterizer._native.tiles import reach_along_y, rows_reached
from rasterizer._native.vectors import FLOATS, LANES

COUNT = 512


@cache
def compiled_alone(function):
    """One of the loops' inlined functions, for Python to call."""
    return numba.njit(fastmath=compiled.FAST)(lambda *numbers: function(*numbers))


def over_arrays(function, *, fixed=()):
    """The function of every row of some arrays and of what is the same for all: an array for each of its results."""
    of_row = compiled_alone(function)
    return lambda *arrays: np.array([of_row(*row, *fixed) for row in zip(*arrays, strict=True)]).T


@intrinsic
def store_all(typingctx, pointer, values):
    """Write a vector, or the vectors of a tuple one behind the other."""

    def codegen(context, builder, signature, arguments):
        several = isinstance(values, types.UniTuple)
        place = builder.bitcast(arguments[0], FLOATS.vector.as_pointer())
        for n, value in enumerate(cgutils.unpack_tuple(builder, arguments[1]) if several else arguments[1:]):
            builder.store(value, builder.gep(place, [cgutils.int32_t(n)]), align=4)
        return context.get_dummy_value()

    return types.void(pointer, values), codegen


@cache
def of_vectors(function, arguments):
    """One of the loops' functions of vectors, for Python: `[arguments, LANES]` to `[results, LANES]` float32."""

    @intrinsic
    def load_all(typingctx, pointer):
        kind = types.UniTuple(FLOATS, arguments)

        def codegen(context, builder, signature, places):
            place = builder.bitcast(places[0], FLOATS.vector.as_pointer())
            vectors = [builder.load(builder.gep(place, [cgutils.int32_t(n)]), align=4) for n in range(arguments)]
            return context.make_tuple(builder, kind, vectors)

        return kind(pointer), codegen

    @numba.njit(fastmath=compiled.FAST)
    def of_lanes(numbers, results, fixed):
        values = function(*(load_all(as_floats(numbers.ctypes.data)) + fixed))
        store_all(as_floats(results.ctypes.data), values)

    return of_lanes


def over_pixels(function, results=1, fixed=()):
    """`over_arrays` of a function of vectors, which has so many results."""

    def of_rows(*arrays):
        count = len(arrays[0])
        rows = np.zeros((len(arrays), -(-count // LANES) * LANES), np.float32)
        rows[:, :count] = arrays
        numbers = np.empty((results, rows.shape[1]), np.float32)
        for start in range(0, rows.shape[1], LANES):
            lanes = np.s_[:, start : start + LANES]
            values = np.empty((results, LANES), np.float32)
            of_vectors(function, len(arrays))(np.ascontiguousarray(rows[lanes]), values, tuple(fixed))
            numbers[lanes] = values
        return numbers[:, :count] if results > 1 else numbers[0, :count]

    return of_rows


@compiled.inlined
def unblend_in_front(t, behind, lit, alpha, unclamped, lit_in_front, rules):
    return native.unblend_in_front(t, behind, lit, alpha, unclamped, rules, lit_in_front)


def thresholds(rules, stop_after=0.0):
    below = np.inf if rules.straight_through else rules.alpha_max
    numbers = rules.alpha_max, rules.alpha_min, rules.transmittance_min, below, stop_after
    return native.Thresholds(*map(np.float32, numbers))


def states(seed):
    """Random states of a pixel before and behind a splat, float32: (t, behind, lit, lit in front, sigma, opacity)."""
    rng = np.random.default_rng(seed)
    t = np.exp(rng.uniform(np.log(1e-4), 0, COUNT))
    sigma = rng.choice([-1e-3, 0, 1, 3, 6, 30, 200], COUNT) * rng.uniform(0, 1, COUNT)
    opacity = rng.choice([0, 1 / 255, 0.3, 0.99, 1], COUNT) * rng.uniform(0.9, 1, COUNT)
    numbers = t, rng.normal(size=COUNT), rng.normal(size=COUNT), rng.normal(size=COUNT), sigma, opacity
    return [np.asarray(x, np.float32) for x in numbers]


def test_the_exponential_is_right_to_a_few_roundings():
    x = np.linspace(0, 79.9, 20_001, dtype=np.float32)
    exps_of_minus = over_pixels(native.exp_minus)
    # The polynomial's own error, and what the exponent lost when it was multiplied: a rounding and a half of it.
    bound = 3e-7 + 1.5 * 2.0**-24 * x
    assert (np.abs(exps_of_minus(x) / np.exp(-x.astype(np.float64)) - 1) < bound).all()
    odd = np.array([-1e-9, -5, 80, 1e30, np.inf, np.nan, -np.inf], np.float32)
    assert (exps_of_minus(odd) < 1e-30).all() and (exps_of_minus(odd) > 0).all()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_sigma_is_the_first_texts(seed):
    dx, dy, xx, xy, yy = np.random.default_rng(seed).normal(size=(5, COUNT)).astype(np.float32)
    expected = np.asarray(blending.splat_sigma(*map(jnp.asarray, (dx, dy, xx, xy, yy))))
    # Contracted or not, a sum of three products is within a few roundings of the largest of them.
    largest = np.abs(xx * dx * dx) + np.abs(xy * dx * dy) + np.abs(yy * dy * dy)
    sigma = over_pixels(native.splat_sigma)(dx, dy, xx, xy, yy)
    assert (np.abs(sigma - expected) <= 4e-7 * largest).all()


@pytest.mark.parametrize("rules", [GSPLAT, INRIA], ids=["gsplat", "inria"])
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_blend_and_unblend_are_the_first_texts(rules, seed):
    t, behind, lit, in_front, sigma, opacity = states(seed)
    fixed, level = thresholds(rules, 0.2), np.float32(0.2)
    signed_t = np.where(np.arange(COUNT) % 5 == 0, -t, t)
    # Alphas before the cut are the first text's: a splat on the cut may be drawn by one exponential alone.
    unclamped = np.where(sigma >= 0, opacity * np.exp(-np.maximum(sigma, 0)), 0).astype(np.float32)
    alpha = np.asarray(blending.cut_alpha(jnp.asarray(unclamped), jnp.asarray(sigma), rules))
    weight, left = blending.blend_splat(jnp.asarray(signed_t), jnp.asarray(alpha), rules)
    np.testing.assert_array_equal(over_pixels(native.cut_alpha, fixed=[fixed])(unclamped), alpha)
    actual = over_pixels(native.blend_splat, 2, fixed=[fixed])(signed_t, alpha)
    near = np.abs(t * (1 - alpha) - rules.transmittance_min) < 1e-9  # stops in one text, goes on in the other
    assert_close(actual[:, ~near], np.stack([weight, left])[:, ~near], why="contracted products", rtol=1e-6, atol=1e-7)

    expected = blending.front_weight(jnp.asarray(t), jnp.asarray(t * alpha), 0.2)
    assert_close(over_pixels(native.front_weight, fixed=[level])(t, t * alpha), np.asarray(expected))

    state = [t, behind, lit, alpha, unclamped]
    expected = np.stack(blending.unblend_splat(*map(jnp.asarray, state), rules))
    actual = over_pixels(native.unblend_splat, 4, fixed=[fixed])(*state)
    assert_close(actual, expected, why="t is divided by up to 0.01", rtol=1e-5, atol=1e-5)
    expected = np.stack(blending.unblend_splat(*map(jnp.asarray, state), rules, (jnp.asarray(in_front), 0.2)))
    # What counts in front jumps where a weight meets the light above the level: there either side is right.
    before = t / (1 - alpha)
    clear = np.abs(before * alpha - np.maximum(before - level, 0)) > 1e-5 * before
    actual = over_pixels(unblend_in_front, 4, fixed=[fixed])(*state, in_front)
    assert_close(actual[:, clear], expected[:, clear], why="t is divided by up to 0.01", rtol=1e-5, atol=1e-4)


@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 2**31), side=st.sampled_from([1, 12]), spread=st.sampled_from([0.02, 0.3, 2.0]))
def test_lists_are_those_of_the_other_engine_to_the_last_entry(seed, side, spread):
    scene = cloud(60, cameras=2, seed=seed)
    scene = replace(scene, scales=spread * scene.scales)
    rng = np.random.default_rng(seed)
    grid = TileGrid(2, scene.width, scene.height, side)
    masks = jnp.asarray(rng.random((2, grid.tiles_y, grid.tiles_x)) < (0.7 if seed % 2 else 1))
    ours, expected = (binned(scene, side, backend=each, masks=masks, capacity=200_000)[2] for each in ("native", "xla"))
    np.testing.assert_array_equal(ours.offsets, expected.offsets)
    total = int(expected.offsets[-1])
    np.testing.assert_array_equal(ours.splats[:total], expected.splats[:total])
    assert ours.needed == expected.needed and not ours.overflowed


@pytest.mark.parametrize(
    ("make_scene", "side", "channels", "ending", "rules"),
    [(stacks, 5, 17, 2, GSPLAT), (cloud, 12, 7, 0, INRIA)],
)
def test_whole_tiles_equal_the_other_engines(make_scene, side, channels, ending, rules):
    """Odd sides, more channels than one pass has, the last ones in front, and the other preset: value and gradient."""
    scene = make_scene()
    projection, grid, pairs = binned(scene, side)
    front = Front(ending, 0.2) if ending else None
    rng = np.random.default_rng(0)
    features = jnp.asarray(rng.normal(size=(1, 40, channels)), jnp.float32)
    weights = jnp.asarray(rng.normal(size=(1, scene.height, scene.width, channels)), jnp.float32)

    def weighed(numbers, backend):
        means2d, conics, opacities, features = numbers
        splats = projection._replace(means2d=means2d, conics=conics)
        how = {"backend": backend, "front": front, "with_median": True}
        image, left, median = blend(splats, opacities, features, pairs, grid, rules, **how)
        return jnp.sum(image * weights) + jnp.sum(left), (image, left, median)

    numbers = projection.means2d, projection.conics, scene.opacities, features
    run = jax.jit(jax.value_and_grad(weighed, has_aux=True), static_argnums=1)
    (_, outputs), slopes = run(numbers, "native")
    (_, expected), right = run(numbers, "xla")
    assert_close(outputs[:2], expected[:2], rtol=1e-5, atol=2e-5, why="sums of up to 40 roundings, in another order")
    np.testing.assert_array_equal(outputs[2], expected[2])
    for a, b in zip(slopes, right, strict=True):
        assert np.linalg.norm(a - b) < 1e-4 * max(np.linalg.norm(b), 1e-6)


@pytest.mark.parametrize("aspect", [1, 10, 1e3, 1e5])
def test_a_reach_is_never_too_short(aspect):
    """Skipped rows hold no pixel that passes the cut: needles whose conic's digits cancel are looked at whole."""
    rng = np.random.default_rng(0)
    angle, sigma = rng.uniform(0, np.pi, 200), 10 ** rng.uniform(-0.3, 1, 200)
    cos, sin = np.cos(angle), np.sin(angle)
    long, short = sigma**2 * aspect, sigma**2 / aspect
    # The inverse is written out: numpy's would lose the digits that this is about.
    xx, yy = cos**2 / long + sin**2 / short, sin**2 / long + cos**2 / short
    xy = cos * sin * (1 / long - 1 / short)
    opacity = np.full(200, 0.8)
    reaches = over_arrays(reach_along_y, fixed=[np.float32(1 / 255)])
    reach = reaches(*(x.astype(np.float32) for x in (xx, xy, yy, opacity)))
    needed = np.sqrt(2 * np.log(0.8 * 255) * (sin**2 * long + cos**2 * short))
    assert (reach >= needed * (1 - 1e-6)).all()
    if aspect < 100:
        assert (reach < 1.01 * needed).all(), "and hardly longer than it must be"


def test_the_rows_of_any_number_lie_within_the_tile():
    odd = np.array([np.nan, np.inf, -np.inf, 3e38, -3e38, -0.5, 3.2, 7.9, 8.6], np.float32)
    y, reach = (x.ravel() for x in np.meshgrid(odd, np.abs(odd)))
    ranges_of_rows = over_arrays(rows_reached, fixed=[8])
    first, end = ranges_of_rows(y, reach)
    assert (first >= 0).all() and (first <= 8).all() and (end >= 0).all() and (end <= 8).all()
    # Pixel centres at half a pixel: a splat at 3.2 that reaches 1 covers the rows of 2.5 and 3.5.
    assert [x.tolist() for x in ranges_of_rows(np.float32([3.2]), np.float32([1.0]))] == [[2], [4]]


def test_lists_of_rubbish_read_nothing_beyond_the_splats():
    """What the stages are handed is a caller's: ids and offsets that make no sense draw something, and end nothing."""
    scene = cloud()
    projection, grid, _ = binned(scene, 8)
    rng = np.random.default_rng(0)
    ids = jnp.asarray(rng.integers(-5, 10**9, 300), jnp.int32)
    offsets = jnp.asarray(rng.integers(-(10**9), 10**9, (1, grid.tiles_y, grid.tiles_x)), jnp.int32)
    arrays = projection.means2d, projection.conics, scene.colors[None], scene.opacities[None]
    how = scene.width, scene.height, 8, offsets, ids
    image, alphas = rasterize_to_pixels(*arrays, *how, backend="native")
    assert np.isfinite(image).all() and (np.asarray(alphas) <= 1).all()
    bad = projection.means2d.at[0, :5].set(jnp.nan)
    image, _ = rasterize_to_pixels(bad, *arrays[1:], *how, backend="native")
    assert np.isfinite(image).all()


@pytest.mark.parametrize("open_row", [0, 3, 7, 8, 15])
def test_a_tile_is_not_left_while_one_row_still_takes_light(open_row):
    """Every other row has stopped long before the last splat of the list, which shows in that row alone."""
    side, red, white = 16, (1.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    rows = [row for row in range(side) if row != open_row for _ in range(3)]
    splats = [(row, 0.99, white) for row in rows] + [(open_row, 0.5, red)]
    means2d = jnp.asarray([[(side / 2, row + 0.5) for row, _, _ in splats]])
    conics = jnp.broadcast_to(jnp.asarray([1e-9, 0.0, 40.0]), (1, len(splats), 3))  # as wide as the tile, a row high
    colors, opacities = jnp.asarray([[c for _, _, c in splats]]), jnp.asarray([[alpha for _, alpha, _ in splats]])
    listed = jnp.zeros((1, 1, 1), jnp.int32), jnp.arange(len(splats), dtype=jnp.int32)
    image, alphas = rasterize_to_pixels(means2d, conics, colors, opacities, side, side, side, *listed, backend="native")
    assert_close(image[0, open_row], np.broadcast_to(0.5 * np.asarray(red), (side, 3)))
    assert_close(alphas[0, open_row], np.full((side, 1), 0.5))
    assert np.min(np.delete(alphas[0], open_row, axis=0)) > 0.9998
