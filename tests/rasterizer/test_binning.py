from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import cloud

from rasterizer import GSPLAT, Projection, TileGrid, bin_splats, binning, count_pairs, project

GRID = TileGrid(2, 37, 29, 8)
CAPACITY = 4096


@jax.jit
def project_scene(scene):
    s = scene
    return project(s.means, s.quats, s.scales, s.opacities, s.viewmats, s.Ks, s.width, s.height)


@pytest.fixture(scope="module", params=["native", "xla"])
def lists(request):
    """The lists of splats by either backend."""
    return partial(listed, backend=request.param)


@partial(jax.jit, static_argnames=("capacity", "backend"))
def listed(projection, opacities, capacity=CAPACITY, backend="xla"):
    return bin_splats(projection, opacities, GRID, capacity, GSPLAT, backend=backend)


def needles(scene):
    rng = np.random.default_rng(5)
    return replace(scene, scales=jnp.asarray(10.0 ** rng.choice([-6, 0], scene.scales.shape), jnp.float32))


def coincident(scene):
    return replace(
        scene,
        means=scene.means.at[:, 2].set(2.0),
        viewmats=jnp.asarray(np.stack([np.eye(4)] * 2), jnp.float32),
    )


SCENES = {
    "cloud": cloud(120, cameras=2),
    "faint": replace(cloud(120, cameras=2), opacities=jnp.linspace(0, 0.02, 120, dtype=jnp.float32)),
    "needles": needles(cloud(120, cameras=2)),
    "coincident depths": coincident(cloud(120, cameras=2)),
}


def greatest_alphas(projection, opacities):
    """`[num_tiles, C * N]` float64: a splat's greatest alpha at the pixel centres of each tile; 0 where invisible."""
    means, conics = (
        np.asarray(x, np.float64).reshape(-1, x.shape[-1]) for x in (projection.means2d, projection.conics)
    )
    opacities = np.where(np.asarray(projection.visible).ravel(), np.tile(np.asarray(opacities, np.float64), 2), 0)
    num_splats = means.shape[0] // GRID.num_cameras
    greatest = np.zeros((GRID.num_tiles, means.shape[0]))
    for y in range(GRID.height):
        for x in range(GRID.width):
            d = means - [x + 0.5, y + 0.5]
            sigma = 0.5 * (conics[:, 0] * d[:, 0] ** 2 + conics[:, 2] * d[:, 1] ** 2) + conics[:, 1] * d[:, 0] * d[:, 1]
            alpha = opacities * np.exp(-np.maximum(sigma, 0))
            for camera in range(GRID.num_cameras):
                own = slice(camera * num_splats, (camera + 1) * num_splats)
                tile = (camera * GRID.tiles_y + y // GRID.tile_size) * GRID.tiles_x + x // GRID.tile_size
                greatest[tile, own] = np.maximum(greatest[tile, own], alpha[own])
    return greatest


@pytest.mark.parametrize("name", SCENES)
def test_every_pair_that_shows_is_listed_once_and_no_other_front_to_back_and_ties_by_index(lists, name):
    scene = SCENES[name]
    projection = project_scene(scene)
    pairs = lists(projection, scene.opacities)
    assert not pairs.overflowed and pairs.offsets[0] == 0
    depths = np.asarray(projection.depths).ravel()
    counts = np.zeros((GRID.num_tiles, depths.size), int)
    for tile, (start, end) in enumerate(zip(pairs.offsets[:-1], pairs.offsets[1:], strict=True)):
        assert start <= end
        splats = np.asarray(pairs.splats[start:end])
        np.add.at(counts[tile], splats, 1)
        np.testing.assert_array_equal(np.lexsort((splats, depths[splats])), np.arange(len(splats)))
    greatest = greatest_alphas(projection, scene.opacities)
    # Pairs within rounding of the cut may be listed or not.
    assert np.all(counts[greatest > GSPLAT.alpha_min * 1.0001] == 1)
    assert counts.max() == 1
    extra = (counts == 1) & (greatest < GSPLAT.alpha_min * 0.98)
    # The listing treats a tile as a box of centres, the test as a grid: a thin ellipse may slip between the centres.
    assert extra.sum() < 0.2 * counts.sum()


def test_capacity_exactly_full_and_one_short(lists):
    scene = SCENES["cloud"]
    projection = project_scene(scene)
    needed = int(count_pairs(projection, GRID))
    roomy = lists(projection, scene.opacities)
    full = lists(projection, scene.opacities, capacity=needed)
    short = lists(projection, scene.opacities, capacity=needed - 1)
    assert needed == roomy.needed == full.needed == short.needed
    assert (bool(roomy.overflowed), bool(full.overflowed), bool(short.overflowed)) == (False, False, True)
    np.testing.assert_array_equal(roomy.offsets, full.offsets)
    total = int(full.offsets[-1])
    np.testing.assert_array_equal(roomy.splats[:total], full.splats[:total])


def test_more_pairs_than_int32_counts_do_not_wrap_round():
    # 3000 splats over 1024 x 1024 tiles: 3.1e9, which int32 would wrap to a negative number.
    shape = (1, 3000)
    projection = Projection(
        jnp.full((*shape, 2), 4096.0),
        jnp.ones(shape),
        jnp.ones((*shape, 3)),
        jnp.full((*shape, 2), 1e5),
        jnp.full(shape, True),
    )
    assert count_pairs(projection, TileGrid(1, 8192, 8192, 8)) == np.iinfo(np.int32).max
    assert count_pairs(projection, TileGrid(1, 2048, 2048, 8)) == 3000 * 256 * 256


@pytest.mark.parametrize("num_tiles", [12, 1 << 16])
def test_a_gpus_sorts_make_the_lists_of_a_cpus(num_tiles):
    """The keys are of two bytes where they hold every tile and what is left over."""
    rng = np.random.default_rng(0)
    tiles = jnp.asarray(np.append(rng.integers(num_tiles - 12, num_tiles + 1, 300), num_tiles), jnp.int32)
    ranks = jnp.sort(jnp.asarray(rng.integers(0, 90, 301), jnp.int32))
    (lists, offsets), (expected, expected_offsets) = (
        jax.jit(make, static_argnums=2)(tiles, ranks, num_tiles) for make in (binning._lists, binning._lists_on_cpu)
    )
    np.testing.assert_array_equal(offsets, expected_offsets)
    listed = int(offsets[-1])
    assert 0 < listed < 301
    np.testing.assert_array_equal(lists[:listed], expected[:listed])


def test_a_gpus_order_by_depth_is_a_cpus():
    depths = jnp.asarray(np.random.default_rng(0).choice([0.5, 1e-3, 1e30, np.inf], 200), jnp.float32)
    bits = jax.lax.bitcast_convert_type(depths, jnp.uint32)
    np.testing.assert_array_equal(binning._order(bits), np.argsort(depths, kind="stable"))
    np.testing.assert_array_equal(binning._order_on_cpu(bits), np.argsort(depths, kind="stable"))
