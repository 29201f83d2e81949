"""gsplat's `info`: its keys, the probe of the 2D means, and what each render mode needs."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import cloud, loss, render
from tolerances import assert_close

import rasterizer
from rasterizer import gsplat

PAIR = cloud(cameras=2)
OPTIONS = {"capacity": 4096, "tile_size": 8, "backend": "native"}
SIZES = {"width": 37, "height": 29, "n_cameras": 2, "tile_size": 8, "tile_width": 5, "tile_height": 4}
KEYS = {"gaussian_ids", "camera_ids", "opacities", "means2d", "radii", "depths", "conics"}
KEYS_OF_LISTS = {"tiles_per_gauss", "isect_offsets", "flatten_ids"}


@pytest.mark.parametrize("backend", ["native", "reference"])
def test_every_backend_has_the_keys_that_it_can_fill(backend):
    info, has_lists = render(PAIR, **{**OPTIONS, "backend": backend})[2], backend != "reference"
    assert all(info[name] is not None for name in KEYS - {"gaussian_ids", "camera_ids"})
    assert {name: info[name] for name in SIZES} == SIZES and all(type(info[name]) is int for name in SIZES)
    assert info["gaussian_ids"] is None and info["camera_ids"] is None  # as in gsplat without packing
    # gsplat's strategies assert that their keys are in it.
    assert all(name in info for name in KEYS | SIZES.keys())
    assert all((name in info) == has_lists for name in KEYS_OF_LISTS | {"splats"})
    assert (info.get("width"), info.get("no_such", 7), "no_such" in info) == (37, 7, False)
    assert (info.get("flatten_ids") is None) == (not has_lists)
    with pytest.raises(KeyError, match="no_such" if has_lists else "splats"):
        info["no_such" if has_lists else "flatten_ids"]


def test_the_lists_draw_the_same_image_through_the_stage_of_gsplat():
    image, alphas, info = render(PAIR, **OPTIONS, rasterize_mode="antialiased")
    colors = jnp.broadcast_to(PAIR.colors[None], (2, *PAIR.colors.shape))
    lists = info["isect_offsets"], info["flatten_ids"], PAIR.backgrounds
    outputs = rasterizer.rasterize_to_pixels(
        info["means2d"], info["conics"], colors, info["opacities"], 37, 29, 8, *lists, backend="native"
    )
    assert_close(outputs, (image, alphas))
    masks = jnp.arange(40).reshape(2, 4, 5) % 3 > 0
    expected = render(PAIR, **OPTIONS, rasterize_mode="antialiased", masks=masks)[:2]
    outputs = rasterizer.rasterize_to_pixels(
        info["means2d"], info["conics"], colors, info["opacities"], 37, 29, 8, *lists, masks, backend="native"
    )
    assert_close(outputs, expected)


def test_tiles_of_a_splat_are_those_that_list_it_and_of_its_box():
    info = render(PAIR, **OPTIONS)[2]
    listed = np.asarray(info["flatten_ids"])
    listed = listed[listed >= 0]
    counts = np.bincount(listed, minlength=80).reshape(2, 40)
    np.testing.assert_array_equal(info["tiles_per_gauss"], counts)
    assert len(listed) == int(info["offsets"][-1]) > 0
    of_boxes = jax.jit(lambda *splats: rasterizer.isect_tiles(*splats, 8, 5, 4, capacity=4096)[0])
    boxes = of_boxes(info["means2d"], info["radii"], info["depths"])
    assert np.all(counts <= boxes) and np.all(counts[np.asarray(info["radii"] == 0).any(-1)] == 0)
    assert info["isect_offsets"].shape == (2, 4, 5) and info["isect_offsets"].dtype == jnp.int32
    assert_close(info["opacities"], jnp.broadcast_to(PAIR.opacities[None], (2, 40)))


@pytest.mark.parametrize("backend", ["native", pytest.param("reference", marks=pytest.mark.long)])
def test_the_probe_takes_the_gradient_of_the_means(backend):
    """A step of all projected means is a step of the principal point, exactly so in a parallel projection."""
    zeros, Ks = jnp.zeros((2, 40, 2), jnp.float32), PAIR.Ks.at[:, :2, :2].multiply(0.3)
    options = {**OPTIONS, "backend": backend, "camera_model": "ortho"}

    @jax.jit
    @partial(jax.grad, argnums=(0, 1), has_aux=True)
    def gradients(zeros, Ks):
        value, (_, _, info) = loss(replace(PAIR, Ks=Ks), **options, means2d_probe=zeros)
        return value, info

    (of_probe, of_Ks), info = gradients(zeros, Ks)
    assert isinstance(info, gsplat.Info) and info["tile_width"] == 5, "jit keeps the sizes"
    assert_close(of_probe.sum(1), of_Ks[:, :2, 2], kind="gradient")
    assert np.abs(of_probe).max() > 0.1
    assert_close(gradients(zeros + 0.25, Ks)[1]["means2d"], info["means2d"] + 0.25)


ONE = cloud()


def test_depth_needs_no_colours():
    expected, *others = (
        render(replace(ONE, colors=colors), capacity=2048, render_mode="ED", backgrounds=None)[:2]
        for colors in (ONE.colors, None)
    )
    jax.tree.map(np.testing.assert_array_equal, others, [expected])


@pytest.mark.parametrize("render_mode", ["D", "RGB+ED"])
def test_a_background_of_the_colours_alone_leaves_depth_over_zero(render_mode):
    image = render(ONE, capacity=2048, render_mode=render_mode)[0]
    behind = jnp.pad(ONE.backgrounds, ((0, 0), (0, 1)))[:, -image.shape[-1] :]
    assert_close(image, render(ONE, capacity=2048, render_mode=render_mode, backgrounds=behind)[0])
