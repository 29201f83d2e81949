"""The native engine lists splats in memory of its own: the same bits as with lists of a given length, anywhere."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import cloud, loss, render, stacks

import rasterizer

ENOUGH = 4096
pytestmark = pytest.mark.skipif(jax.default_backend() != "cpu", reason="the native loops are a CPU's")


def in_jit(scene, **options):
    return jax.jit(lambda s: jax.value_and_grad(loss, has_aux=True)(s, backend="native", **options))(scene)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"render_mode": "RGB+ED", "depth_mode": "plane", "return_median_depth": True},
        {"masks": jnp.arange(20).reshape(1, 4, 5) % 3 > 0},
    ],
    ids=["colours", "median", "masks"],
)
@pytest.mark.parametrize("scene", [cloud(cameras=1), stacks()], ids=["cloud", "stacks"])
def test_a_compiled_program_without_capacity_has_the_bits_of_one_with_it(scene, options):
    (value, (image, alphas, info)), gradient = in_jit(scene, **options)
    (listed_value, listed), listed_gradient = in_jit(scene, capacity=ENOUGH, **options)
    assert not listed[2]["overflowed"] and not info["overflowed"]
    assert int(info["needed"]) == int(listed[2]["needed"])
    assert "splats" not in info
    expected = listed_value, listed[0], listed[1], listed_gradient
    jax.tree.map(np.testing.assert_array_equal, (value, image, alphas, gradient), expected)
    if "return_median_depth" in options:
        np.testing.assert_array_equal(info["median_depths"], listed[2]["median_depths"])


def test_more_channels_than_one_pass_has_are_listed_in_every_pass():
    scene = cloud(channels=19)
    compiled = jax.jit(lambda s: render(s, backend="native")[0])
    np.testing.assert_array_equal(compiled(scene), render(scene, backend="native", capacity=ENOUGH)[0])


def test_a_compiled_batch_is_its_scenes():
    scenes = [cloud(), replace(cloud(), scales=0.2 * cloud().scales)]
    batch = jax.tree.map(lambda *x: jnp.stack(x), *scenes)
    images = jax.jit(jax.vmap(lambda s: render(s, backend="native")[0]))(batch)
    for image, scene in zip(images, scenes, strict=True):
        np.testing.assert_allclose(image, render(scene, backend="native", capacity=ENOUGH)[0], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_and_one_splat_are_listed(count):
    scene = jax.tree.map(lambda x: x, cloud())
    few = replace(
        scene, **{name: getattr(scene, name)[:count] for name in ("means", "quats", "scales", "opacities", "colors")}
    )
    compiled = jax.jit(lambda s: render(s, backend="native")[:2])(few)
    jax.tree.map(np.testing.assert_array_equal, compiled, render(few, backend="native", capacity=ENOUGH)[:2])


def test_gradients_of_absolutes_still_need_a_capacity():
    with pytest.raises(ValueError, match="inside jit .* pass capacity="):
        jax.jit(lambda s: render(s, backend="native", absgrad=jnp.zeros((1, 40, 2)))[0])(cloud())


def test_blend_names_a_backend_that_needs_lists():
    scene = cloud()
    projection = rasterizer.project(
        scene.means, scene.quats, scene.scales, scene.opacities, scene.viewmats, scene.Ks, scene.width, scene.height
    )
    grid = rasterizer.TileGrid(1, scene.width, scene.height, 8)
    with pytest.raises(ValueError, match="pairs=None: backend='xla' needs the lists of bin_splats"):
        rasterizer.blend(projection, scene.opacities, scene.colors[None], None, grid, backend="xla")
