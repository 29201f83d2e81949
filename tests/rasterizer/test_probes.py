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


@partial(jax.jit, static_argnames=("grid", "backend", "front"))
@partial(jax.value_and_grad, has_aux=True)
def sum_and_gradients(arrays, weights, projection, pairs, grid, *, backend, front):
    """Of the image and the light left, so that every gradient is that of known weights."""
    means2d, conics, opacities, features, probes = arrays
    placed = projection._replace(means2d=means2d, conics=conics)
    image, left, _ = blend(placed, opacities, features, pairs, grid, backend=backend, front=front, probes=probes)
    assert image.shape[-1] == features.shape[-1] + probes.shape[-1]
    zeros = image[..., features.shape[-1] :]
    return jnp.sum(weights * jnp.concatenate([image, left], -1)), zeros


LOOPS = [
    ("native", 3, None, 2),
    ("native", 1, None, 1),
    ("native", 7, FRONT, 4),
    ("native", 15, None, 2),
    ("listing", 7, FRONT, 2),
    ("listing", 15, None, 2),
]
LOOPS = LOOPS if "native" in BACKENDS else []


@pytest.mark.parametrize(
    ("backend", "channels", "front", "count"),
    [
        *LOOPS,
        ("xla", 3, None, 2),
        ("xla", 7, FRONT, 4),
        *(pytest.param("pallas", 7, front, 4, marks=pytest.mark.long) for front in (None, FRONT)),
    ],
)
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
    how = {"grid": grid, "front": front}
    listed = None if backend == "listing" else pairs
    (value, zeros), gradients = sum_and_gradients(arrays, weights, projection, listed, backend=engine, **how)
    np.testing.assert_array_equal(zeros, 0)
    with jax.enable_x64(True):
        single = arrays, weights, projection
        double = jax.tree.map(lambda x: np.asarray(x, np.float64) if x.dtype == jnp.float32 else x, single)
        (expected, _), oracle = sum_and_gradients(*double, pairs=None, backend="reference", **how)
    assert_close((value, gradients[-1]), (expected, oracle[-1]), kind="gradient")
    assert_close(gradients[:-1], oracle[:-1], kind="gradient")
