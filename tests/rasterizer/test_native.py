"""The native loops: their lists and whole tiles against the other engines, and lists of rubbish."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import binned, cloud, stacks
from tolerances import assert_close

from rasterizer import Front, TileGrid, blend, rasterize_to_pixels


@partial(jax.jit, static_argnames=("side", "backend"))
def lists(scene, side, masks, backend):
    return binned(scene, side, backend=backend, masks=masks, capacity=200_000)[2]


@pytest.mark.parametrize("side", [12, pytest.param(1, marks=pytest.mark.long)])
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 2**31), spread=st.sampled_from([0.02, 0.3, 2.0]))
def test_lists_are_those_of_the_other_engine_to_the_last_entry(side, seed, spread):
    scene = cloud(60, cameras=2, seed=seed)
    scene = replace(scene, scales=spread * scene.scales)
    rng = np.random.default_rng(seed)
    grid = TileGrid(2, scene.width, scene.height, side)
    masks = jnp.asarray(rng.random((2, grid.tiles_y, grid.tiles_x)) < (0.7 if seed % 2 else 1))
    ours, expected = (lists(scene, side, masks, backend=each) for each in ("native", "xla"))
    np.testing.assert_array_equal(ours.offsets, expected.offsets)
    total = int(expected.offsets[-1])
    np.testing.assert_array_equal(ours.splats[:total], expected.splats[:total])
    assert ours.needed == expected.needed and not ours.overflowed


def test_whole_tiles_equal_the_other_engines():
    """An odd side, more channels than one pass has, and the last ones in front: value and gradient."""
    scene, channels = stacks(), 17
    projection, grid, pairs = binned(scene, 5)
    rng = np.random.default_rng(0)
    features = jnp.asarray(rng.normal(size=(1, 40, channels)), jnp.float32)
    weights = jnp.asarray(rng.normal(size=(1, scene.height, scene.width, channels)), jnp.float32)

    def weighed(numbers, backend):
        means2d, conics, opacities, features = numbers
        splats = projection._replace(means2d=means2d, conics=conics)
        how = {"backend": backend, "front": Front(2, 0.2), "with_median": True}
        image, left, median = blend(splats, opacities, features, pairs, grid, **how)
        return jnp.sum(image * weights) + jnp.sum(left), (image, left, median)

    numbers = projection.means2d, projection.conics, scene.opacities, features
    run = jax.jit(jax.value_and_grad(weighed, has_aux=True), static_argnums=1)
    (_, outputs), slopes = run(numbers, "native")
    (_, expected), right = run(numbers, "xla")
    assert_close(outputs[:2], expected[:2], rtol=1e-5, atol=2e-5, why="sums of up to 40 roundings, in another order")
    np.testing.assert_array_equal(outputs[2], expected[2])
    for a, b in zip(slopes, right, strict=True):
        assert np.linalg.norm(a - b) < 1e-4 * max(np.linalg.norm(b), 1e-6)


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


@pytest.mark.parametrize("open_row", [0, 8, 15])
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
