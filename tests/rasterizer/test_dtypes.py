"""Arrays of any real dtype are rendered in float32, and a gradient has the dtype of the array that was passed."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import cloud, in_float64, loss, render
from tolerances import assert_close

SCENE = cloud()
# Powers of two and whole numbers: every dtype below holds them exactly.
WHOLE = replace(
    SCENE,
    viewmats=jnp.eye(4, dtype=jnp.float32)[None],
    Ks=jnp.array([[[32, 0, 18], [0, 32, 14], [0, 0, 1]]], jnp.float32),
)
MIXED = {
    "means": jnp.float16,
    "colors": jnp.bfloat16,
    "opacities": jnp.bfloat16,
    "viewmats": jnp.int32,
    "Ks": jnp.int16,
    "backgrounds": jnp.float16,
}


def cast(scene, dtypes):
    return replace(scene, **{name: getattr(scene, name).astype(dtype) for name, dtype in dtypes.items()})


@partial(jax.jit, static_argnames=("names", "backend"))
def image_and_gradients(scene, names, backend):
    def of(arrays):
        value, (image, *_) = loss(replace(scene, **arrays), capacity=2048, backend=backend)
        return value, image

    slopes, image = jax.grad(of, has_aux=True)({name: getattr(scene, name) for name in names})
    return image, slopes


# Dtypes are the front door's, the same for every engine of tiles.
def test_other_dtypes_are_cast_and_gradients_come_back_in_them():
    mixed = cast(WHOLE, MIXED)
    rounded = cast(mixed, dict.fromkeys(MIXED, jnp.float32))
    names = "means", "colors", "opacities", "backgrounds", "quats"
    (image, slopes), (expected_image, expected) = (image_and_gradients(s, names, "native") for s in (mixed, rounded))
    assert image.dtype == jnp.float32
    assert_close(image, expected_image)
    for name in names:
        assert slopes[name].dtype == getattr(mixed, name).dtype
        np.testing.assert_array_equal(slopes[name], expected[name].astype(slopes[name].dtype))


@pytest.mark.parametrize("backend", ["reference", "native"])
def test_the_dtype_of_the_gaussians_decides_and_float64_is_the_references_alone(backend, x64):
    """Cameras alone are in float64 where they come from numpy."""
    finer = in_float64(SCENE)
    cameras = replace(SCENE, viewmats=finer.viewmats, Ks=finer.Ks)
    own = jnp.float64 if backend == "reference" else jnp.float32
    for scene, name, dtype in ((finer, "means", own), (cameras, "viewmats", jnp.float32)):
        image, slopes = jax.eval_shape(partial(image_and_gradients, names=(name,), backend=backend), scene)
        assert image.dtype == dtype and slopes[name].dtype == jnp.float64


def test_the_native_loops_render_float64_as_float32():
    expected = render(SCENE, backend="native")[0]
    with jax.enable_x64(True):
        np.testing.assert_array_equal(render(in_float64(SCENE), backend="native")[0], expected)
