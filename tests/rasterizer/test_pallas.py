"""The GPU kernels without a GPU: interpreted against their twins, and lowered for CUDA."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxprs import equations
from scenes import binned, stacks
from tolerances import assert_close

from rasterizer import GSPLAT, Front, TileGrid, _mosaic, _pallas, _reference, _xla, devices
from rasterizer.compositing import Static, composite


def splats_and_lists(scene, capacity):
    """A scene's splats, its tiles of 16 pixels, and the splats' lists."""
    compiled = jax.jit(lambda scene: binned(scene, 16, backend="xla", capacity=capacity)[::2])
    projection, pairs = compiled(scene)
    return projection, TileGrid(1, scene.width, scene.height, 16), pairs


def test_sorted_sums_are_those_of_every_place():
    rng = np.random.default_rng(0)
    places, values = rng.integers(0, 9, 500).astype(np.int32), rng.normal(size=(500, 3)).astype(np.float32)
    expected = np.stack([values[places == place].astype(np.float64).sum(0) for place in range(8)])
    for sums in (_pallas.sorted_sums, _pallas.atomic_sums):
        assert_close(jax.jit(sums, static_argnums=2)(jnp.asarray(values), jnp.asarray(places), 8), expected)
    only_left_out = jnp.full(3, 8, jnp.int32)
    nothing = jax.jit(_pallas.sorted_sums, static_argnums=2)(jnp.ones((3, 2), jnp.float32), only_left_out, 8)
    np.testing.assert_array_equal(nothing, np.zeros((8, 2)))


def abstract(*shape, dtype=jnp.float32):
    return jax.ShapeDtypeStruct(shape, dtype)


def abstract_lists(grid, capacity=512):
    """Splats and offsets of a grid's lists."""
    return abstract(capacity, dtype=jnp.int32), abstract(grid.num_tiles + 1, dtype=jnp.int32)


def test_with_sorted_sums_the_backward_pass_adds_by_no_scatter():
    grid = TileGrid(1, 37, 29, 16)
    inputs = abstract(40, 9), abstract_lists(grid)

    def adds(sum_rows):
        engine = _pallas.engine(interpret=True, sum_rows=sum_rows)
        static = Static(grid, GSPLAT, engine)
        blended = jax.eval_shape(partial(engine.forward, static), *inputs)
        arguments = *inputs, blended.transmittance, blended.last, *blended[:2], *blended.residuals
        operations = equations(jax.make_jaxpr(partial(engine.backward, static))(*arguments).jaxpr)
        scatters = [e for e in operations if "scatter" in e.primitive.name and "add" in e.primitive.name]
        return [e for e in scatters if jnp.issubdtype(e.outvars[0].aval.dtype, jnp.floating)]

    assert adds(_pallas.atomic_sums) and not adds(_pallas.sorted_sums)


def test_lists_cut_in_segments_equal_the_reference():
    """Lists of up to 40 splats in segments of 16: values and gradients pass their borders, however they are summed."""
    front = Front(2, 0.2)
    scene = stacks()
    projection, grid, pairs = splats_and_lists(scene, 512)
    assert np.diff(pairs.offsets).max() > 32
    rng = np.random.default_rng(3)
    features = jnp.asarray(rng.normal(size=(len(scene.means), 4)), jnp.float32)
    weights = jnp.asarray(rng.normal(size=(1, scene.height, scene.width, 5)), jnp.float32)

    def dense(means2d, conics, opacities, features):
        splats = projection._replace(means2d=means2d[None], conics=conics[None])
        return _reference.composite(splats, opacities[None], features[None], *grid[1:3], GSPLAT, front)

    def tiles(segment_size, sum_rows, *splats):
        engine = _pallas.engine(interpret=True, segment_size=segment_size, sum_rows=sum_rows)
        return composite(Static(grid, GSPLAT, engine, True, front), *splats, (pairs.splats, pairs.offsets))

    def weighed(blended, *splats):
        image, left, median = blended(*splats)
        return jnp.sum(jnp.concatenate([image, left], -1) * weights), (image, left, median)

    splats = projection.means2d[0], projection.conics[0], scene.opacities, features
    results = [
        jax.jit(jax.value_and_grad(partial(weighed, blended), (0, 1, 2, 3), has_aux=True))(*splats)
        for blended in (partial(tiles, 256, _pallas.atomic_sums), partial(tiles, 16, _pallas.sorted_sums), dense)
    ]
    (((_, outputs), slopes), ((_, outputs_in_parts), slopes_in_parts), ((_, right), expected_slopes)) = results
    assert_close(outputs_in_parts[:2], right[:2])
    jax.tree.map(np.testing.assert_array_equal, outputs_in_parts[1:], outputs[1:])
    np.testing.assert_array_equal(outputs_in_parts[2], right[2])
    names = "means2d", "conics", "opacities", "features"
    for name, a, b, c in zip(names, slopes_in_parts, expected_slopes, slopes, strict=True):
        assert np.linalg.norm(a - b) < 1e-5 * np.linalg.norm(b), name
        assert np.linalg.norm(a - c) < 1e-5 * np.linalg.norm(c), name


def lowered_for_cuda(program, *arguments):
    """The program's text for a GPU, on a machine without one."""
    traced = jax.jit(program).trace(*arguments)
    if jax.__version_info__ < (0, 11):
        return traced.lower(lowering_platforms=("cuda",)).as_text()
    from jax.sharding import AbstractDevice, AbstractMesh

    h100 = AbstractDevice(device_kind="NVIDIA H100 80GB HBM3", num_cores=132, platform="cuda")
    with jax.sharding.use_abstract_mesh(AbstractMesh((1,), ("x",), abstract_device=h100)):
        return jax.jit(program).trace(*arguments).lower(lowering_platforms=("cuda",)).as_text()


@pytest.mark.parametrize("tile_size, channels", [(16, 3), (32, 16)])
def test_both_kernels_lower_for_cuda(tile_size, channels):
    grid = TileGrid(1, 100, 60, tile_size)
    front = Front(4, 0.2) if channels == 16 else None
    static = Static(grid, GSPLAT, _pallas.engine(interpret=False), with_median=channels == 3, front=front)

    def loss(splats, lists):
        image, left, _ = composite(static, *splats, lists)
        return jnp.sum(image**2) + jnp.sum(left)

    splats = abstract(50, 2), abstract(50, 3), abstract(50), abstract(50, channels)
    lists = abstract_lists(grid)
    assert lowered_for_cuda(loss, splats, lists).count("custom_call @__gpu$xla.gpu.triton") == 1
    gradient = jax.grad(loss)
    assert lowered_for_cuda(gradient, splats, lists).count("custom_call @__gpu$xla.gpu.triton") == 2


needs_mosaic = pytest.mark.skipif(not devices.has_mosaic(), reason="jax 0.12 or later has what is tested")


@pytest.fixture(scope="module")
def tile():
    """A tile of 24 splats, and a program of its values and gradients by an engine."""
    scene = stacks(count=24, size=(16, 16))
    projection, grid, pairs = splats_and_lists(scene, 64)

    def loss(engine, *splats):
        static = Static(grid, GSPLAT, engine, True)
        image, left, median = composite(static, *splats, (pairs.splats, pairs.offsets))
        return jnp.sum(image**2) + jnp.sum(left), (image, left, median)

    def program(engine):
        return jax.jit(jax.value_and_grad(partial(loss, engine), (0, 1, 2, 3), has_aux=True))

    return program, (projection.means2d[0], projection.conics[0], scene.opacities, scene.colors)


@needs_mosaic
def test_kernels_by_mosaic_equal_their_twin(tile):
    program, splats = tile
    (_, outputs), slopes = program(_mosaic.engine(interpret=True, segment_size=16))(*splats)
    (_, expected), right = program(_xla.ENGINE)(*splats)
    assert_close(outputs[:2], expected[:2])
    np.testing.assert_array_equal(outputs[2], expected[2])
    for slope, reference in zip(slopes, right, strict=True):
        assert np.linalg.norm(slope - reference) < 1e-5 * np.linalg.norm(reference)
