"""The kernels by Mosaic: interpreted against their twin, and lowered for CUDA."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import stacks
from tolerances import assert_close

from rasterizer import GSPLAT, Front, TileGrid, _mosaic, _xla, bin_splats, devices, project
from rasterizer.compositing import Static, composite

pytestmark = pytest.mark.skipif(not devices.has_mosaic(), reason="jax 0.12 or later has what is tested")


@pytest.fixture(scope="module")
def tile():
    """A tile of 24 splats, and a program of its values and gradients by an engine."""
    scene = stacks(count=24, size=(16, 16))
    shape = scene.means, scene.quats, scene.scales, scene.opacities
    projection = project(*shape, scene.viewmats, scene.Ks, 16, 16)
    grid = TileGrid(1, 16, 16, 16)
    pairs = bin_splats(projection, scene.opacities, grid, 64, GSPLAT, backend="xla")

    def loss(engine, front, *splats):
        static = Static(grid, GSPLAT, engine, True, front)
        image, left, median = composite(static, *splats, pairs.splats, pairs.offsets)
        return jnp.sum(image**2) + jnp.sum(left), (image, left, median)

    def program(engine, front=None):
        return jax.jit(jax.value_and_grad(partial(loss, engine, front), (0, 1, 2, 3), has_aux=True))

    return program, (projection.means2d[0], projection.conics[0], scene.opacities, scene.colors)


def test_interpreted_kernels_equal_their_twin(tile):
    program, splats = tile
    (_, shown), slopes = program(_mosaic.engine(interpret=True, segment_size=16))(*splats)
    (_, expected), right = program(_xla.ENGINE)(*splats)
    assert_close(shown[:2], expected[:2])
    np.testing.assert_array_equal(shown[2], expected[2])
    for found, wanted in zip(slopes, right, strict=True):
        assert np.linalg.norm(found - wanted) < 1e-5 * np.linalg.norm(wanted)


def test_kernels_lower_for_cuda_and_what_mosaic_cannot_do_is_jnp(tile):
    program, splats = tile

    def calls(front):
        traced = program(_mosaic.engine(interpret=False), front).trace(*splats)
        return traced.lower(lowering_platforms=("cuda",)).as_text().count("custom_call @mosaic_gpu")

    assert calls(None) == 2
    assert calls(Front(1, 0.2)) == 0
