"""Without cuts the image is smooth: finite differences agree, to second order where a backend has it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scenes import BACKENDS, GAUSSIAN_FIELDS, in_float64, render, smooth

import rasterizer

NAMES = (*GAUSSIAN_FIELDS, "viewmats", "Ks", "backgrounds")


def functional(scene, **options):
    """A random functional of image and alphas, of the arrays of a scene."""
    weights = np.random.default_rng(0).normal(size=(1, 5, 6, 3))

    def value(arrays):
        image, alphas, _ = render(replace(scene, **arrays), rules=rasterizer.SMOOTH, **options)
        seen = jnp.concatenate([image, alphas], -1)
        return jnp.sum(jnp.asarray(weights, seen.dtype) * seen**2)

    return jax.jit(value)


@pytest.mark.parametrize("mode", ["classic", pytest.param("antialiased", marks=pytest.mark.long)])
def test_second_order_of_the_reference(mode, x64):
    scene = in_float64(smooth())
    value = functional(scene, backend="reference", rasterize_mode=mode)
    arrays = {name: getattr(scene, name) for name in ("means", "scales", "opacities")}
    check_grads(value, (arrays,), order=2, modes=("rev",), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("backend", [name for name in BACKENDS if name != "reference"])
def test_first_order_of_the_tiles(backend):
    scene = smooth()
    value = functional(scene, backend=backend, capacity=64)
    arrays = {name: getattr(scene, name) for name in NAMES}
    check_grads(value, (arrays,), order=1, modes=("rev",), rtol=2e-2, atol=2e-2, eps=1e-2)  # in float32


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_splat_reaches_every_tile(backend):
    scene = replace(smooth(), scales=smooth().scales * 0.01, width=40, height=30)
    image, alphas, info = render(scene, backend=backend, capacity=256, tile_size=8, rules=rasterizer.SMOOTH)
    assert np.isfinite(image).all() and np.isfinite(alphas).all()
    assert info["visible"].all() and (info["radii"] > 10**9).all()
    if backend != "reference":
        np.testing.assert_array_equal(info["tiles_per_gauss"], np.full((1, 4), 20))
