"""Probes, channels of zeros, have the gradient of a channel on every backend, and leave all else as it is."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import BACKENDS, binned, cloud
from tolerances import assert_close

from rasterizer import Front, blend, default_tile_size

pytestmark = pytest.mark.device
FRONT = Front(4, 0.2)


def weighted_sum(arrays, weights, projection, pairs, grid, *, backend, front):
    """Of the image and the light left, so that every gradient is that of known weights."""
    means2d, conics, opacities, features, probes = arrays
    placed = projection._replace(means2d=means2d, conics=conics)
    image, left, _ = blend(placed, opacities, features, pairs, grid, backend=backend, front=front, probes=probes)
    assert image.shape[-1] == features.shape[-1] + probes.shape[-1]
    zeros = image[..., features.shape[-1] :]
    return jnp.sum(weights * jnp.concatenate([image, left], -1)), zeros


LOOPS = ["native", "listing"] if "native" in BACKENDS else []


@pytest.mark.parametrize(
    ("channels", "front", "count"),
    [(3, None, 2), (1, None, 1), (3, None, 4), (7, FRONT, 2), (7, FRONT, 4), (15, None, 2)],
)
@pytest.mark.parametrize("backend", [*LOOPS, "xla", pytest.param("pallas", marks=pytest.mark.long)])
def test_a_probe_has_the_gradient_of_a_channel_of_zeros(backend, channels, front, count):
    """`listing`: the native loops list splats by themselves. 15 and 2 channels are over those of one pass."""
    scene, random = cloud(cameras=2), np.random.default_rng(0)
    engine = "native" if backend == "listing" else backend
    projection, grid, pairs = binned(scene, default_tile_size(engine), backend=engine, capacity=4096)
    shape = projection.depths.shape
    features = jnp.asarray(random.uniform(size=(*shape, channels)), jnp.float32)
    opacities = jnp.broadcast_to(scene.opacities, shape)
    arrays = projection.means2d, projection.conics, opacities, features, jnp.zeros((*shape, count), jnp.float32)
    size = 2, scene.height, scene.width
    weights = jnp.asarray(random.normal(size=(*size, channels + count + 1)), jnp.float32)
    differentiated = jax.jit(jax.value_and_grad(partial(weighted_sum, front=front), has_aux=True),
                             static_argnames=("grid", "backend"))  # fmt: skip
    listed = None if backend == "listing" else pairs
    (value, zeros), gradients = differentiated(arrays, weights, projection, listed, grid=grid, backend=engine)
    np.testing.assert_array_equal(zeros, 0)
    with jax.enable_x64(True):
        single = arrays, weights, projection
        double = jax.tree.map(lambda x: np.asarray(x, np.float64) if x.dtype == jnp.float32 else x, single)
        (expected, _), oracle = differentiated(*double, pairs=None, grid=grid, backend="reference")
    assert_close((value, gradients[-1]), (expected, oracle[-1]), kind="gradient")
    assert_close(gradients[:-1], oracle[:-1], kind="gradient")
