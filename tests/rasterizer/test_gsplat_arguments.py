"""gsplat's arguments at the front door: what asks for nothing is taken, what is not supported is refused by name."""

from dataclasses import replace
from enum import Enum
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import cloud, render
from tolerances import assert_close

from rasterizer import spherical_harmonics

SCENE = cloud()
RollingShutter = Enum("RollingShutter", ["ROLLING_TOP_TO_BOTTOM", "GLOBAL"])

# The signature of gsplat 1.6, without what this front door has itself.
DEFAULTS = {
    "packed": True,
    "sparse_grad": False,
    "channel_chunk": 32,
    "distributed": False,
    "segmented": False,
    "with_ut": False,
    "with_eval3d": False,
    "global_z_order": True,
    "rays": None,
    "tangential_coeffs": None,
    "thin_prism_coeffs": None,
    "ftheta_coeffs": None,
    "lidar_coeffs": None,
    "external_distortion_coeffs": None,
    "rolling_shutter": RollingShutter.GLOBAL,
    "viewmats_rs": None,
    "ut_params": None,
    "extra_signals": None,
    "extra_signals_sh_degree": None,
    "renderer_config": None,
}


def drawn(**options):
    return render(SCENE, capacity=2048, **options)


def test_at_their_defaults_they_change_nothing():
    expected = drawn()
    for options in (DEFAULTS, {"packed": False, "channel_chunk": 1}):
        image, alphas, _ = drawn(**options)
        np.testing.assert_array_equal(image, expected[0])
        np.testing.assert_array_equal(alphas, expected[1])


REFUSED = {
    "sparse_grad": (True, "gradients are dense"),
    "distributed": (True, "one device"),
    "segmented": (True, "there is one sort"),
    "with_ut": (True, ""),
    "with_eval3d": (True, ""),
    "global_z_order": (False, "camera z"),
    "rays": (np.zeros((1, 29, 37, 6)), ""),
    "tangential_coeffs": (np.zeros((1, 2)), "undistort"),
    "thin_prism_coeffs": (np.zeros((1, 4)), "undistort"),
    "ftheta_coeffs": (SimpleNamespace(), ""),
    "lidar_coeffs": (SimpleNamespace(), ""),
    "external_distortion_coeffs": (SimpleNamespace(), ""),
    "rolling_shutter": (RollingShutter.ROLLING_TOP_TO_BOTTOM, ""),
    "viewmats_rs": (np.eye(4)[None], ""),
    "ut_params": (SimpleNamespace(), ""),
    "extra_signals": (np.zeros((40, 2)), "further channels of `colors`"),
    "extra_signals_sh_degree": (3, ""),
    "renderer_config": (SimpleNamespace(), ""),
}


def test_every_argument_that_asks_for_something_is_tried():
    assert REFUSED.keys() | {"packed", "channel_chunk"} == DEFAULTS.keys()


@pytest.mark.parametrize("name", REFUSED)
def test_other_values_are_refused_by_name(name):
    value, reason = REFUSED[name]
    with pytest.raises(ValueError, match=rf"^{name}(=.*)? is not supported.*{reason}") as caught:
        drawn(**{**DEFAULTS, name: value})
    assert "\n" not in str(caught.value)


def test_a_name_that_gsplat_has_not_is_a_type_error():
    with pytest.raises(TypeError, match="unexpected keyword argument 'renger_mode'"):
        drawn(renger_mode="RGB")


@pytest.mark.parametrize("render_mode", ["D", "ED"])
def test_depth_needs_no_colours(render_mode):
    expected = drawn(render_mode=render_mode, backgrounds=None)
    for scene in (replace(SCENE, colors=None), replace(SCENE, colors=jnp.zeros((40, 5)))):
        image, alphas, _ = render(scene, capacity=2048, render_mode=render_mode, backgrounds=None)
        np.testing.assert_array_equal(image, expected[0])
        np.testing.assert_array_equal(alphas, expected[1])


@pytest.mark.parametrize("render_mode", ["RGB", "RGB+D", "RGB+ED"])
def test_colours_need_colours(render_mode):
    with pytest.raises(ValueError, match="colors=None needs a render_mode of depth alone, not 'RGB"):
        render(replace(SCENE, colors=None), capacity=2048, render_mode=render_mode, backgrounds=None)


@pytest.mark.parametrize("render_mode", ["D", "RGB+D", "RGB+ED"])
def test_a_background_of_the_colours_alone_leaves_depth_over_zero(render_mode):
    image, alphas, _ = drawn(render_mode=render_mode)
    depth = drawn(render_mode=render_mode, backgrounds=None)[0][..., -1:]
    np.testing.assert_array_equal(image[..., -1:], depth)
    if "RGB" in render_mode:
        assert_close(image[..., :3], drawn()[0])
    behind = jnp.concatenate([SCENE.backgrounds, jnp.full((1, 1), 7.0)], -1)[:, -image.shape[-1] :]
    whole = drawn(render_mode=render_mode, backgrounds=behind)[0]
    assert_close(whole[..., -1:], depth + 7 * (1 - alphas))


def test_harmonics_without_a_channel_are_refused():
    with pytest.raises(ValueError, match=r"coeffs.shape=\(8, 25, 0\) holds no channel"):
        spherical_harmonics(0, jnp.ones((8, 3)), jnp.ones((8, 25, 0)))
    with pytest.raises(ValueError, match=r"colors.shape=.* holds no channel"):
        render(replace(SCENE, colors=jnp.ones((40, 4, 0))), capacity=2048, sh_degree=1, backgrounds=None)
