"""Arrays of any real dtype are rendered in float32, and a gradient has the dtype of the array that was passed."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import BACKENDS, cloud, loss
from tolerances import assert_close

from gsjax import rendering
from gsjax.rendering import Drawable
from gsjax.scene.cameras import Camera

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


def gradients(scene, names, **options):
    def of(arrays):
        return loss(replace(scene, **arrays), capacity=2048, **options)[0]

    return jax.grad(of)({name: getattr(scene, name) for name in names})


@pytest.mark.parametrize("backend", BACKENDS)
def test_other_dtypes_are_cast_and_gradients_come_back_in_them(backend):
    mixed = cast(WHOLE, MIXED)
    rounded = cast(mixed, dict.fromkeys(MIXED, jnp.float32))
    image = loss(mixed, capacity=2048, backend=backend)[1][0]
    assert image.dtype == jnp.float32
    assert_close(image, loss(rounded, capacity=2048, backend=backend)[1][0])
    names = ["means", "colors", "opacities", "backgrounds", "quats"]
    slopes, expected = (gradients(scene, names, backend=backend) for scene in (mixed, rounded))
    for name in names:
        assert slopes[name].dtype == getattr(mixed, name).dtype
        np.testing.assert_array_equal(slopes[name], expected[name].astype(slopes[name].dtype))


@pytest.mark.parametrize("backend", BACKENDS)
def test_float64_is_read_as_float32_but_by_the_reference(backend, x64):
    finer = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), jnp.float64), SCENE)
    image = loss(finer, capacity=2048, backend=backend)[1][0]
    assert image.dtype == (jnp.float64 if backend == "reference" else jnp.float32)
    assert_close(image.astype(jnp.float32), loss(SCENE, capacity=2048, backend=backend)[1][0])
    assert gradients(finer, ["means"], backend=backend)["means"].dtype == jnp.float64
    # Cameras alone are in float64 where they come from numpy: the Gaussians decide.
    cameras = replace(SCENE, viewmats=finer.viewmats, Ks=finer.Ks)
    assert loss(cameras, capacity=2048, backend=backend)[1][0].dtype == jnp.float32
    assert gradients(cameras, ["viewmats"], backend=backend)["viewmats"].dtype == jnp.float64


@pytest.mark.parametrize("backend", ["reference", "xla"])
def test_a_view_of_gsjax_too(backend):
    def colors(arrays, camera):
        none = jnp.zeros((40, 0, 3), jnp.bfloat16)
        scene = Drawable(arrays["means"], arrays["opacities"], arrays["colors"][:, None], none, *arrays["shapes"])
        how = {"capacity": 2048, "background": jnp.ones(3, jnp.int32), "backend": backend}
        return jnp.sum(rendering.render(scene, camera, **how, with_depth=True, extra=arrays["colors"]).colors ** 2)

    mixed = cast(WHOLE, MIXED)
    rounded = cast(mixed, dict.fromkeys(MIXED, jnp.float32))
    values, slopes = [], []
    for s in (mixed, rounded):
        arrays = {"means": s.means, "opacities": s.opacities, "colors": s.colors, "shapes": (s.quats, s.scales)}
        camera = Camera(s.viewmats[0], s.Ks[0], s.width, s.height)
        value, slope = jax.value_and_grad(colors)(arrays, camera)
        values.append(value)
        slopes.append(slope)
    assert_close(*values)
    for name in ("means", "opacities", "colors"):
        assert slopes[0][name].dtype == MIXED[name]
        np.testing.assert_array_equal(slopes[0][name], slopes[1][name].astype(MIXED[name]))
