"""The tile backends against the dense reference: values, alphas and all gradients, one body for every case."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import cloud, evaluate, relative_errors, render, stacks
from tolerances import assert_close

from rasterizer import INRIA

# name -> (scene, options). Between them: every mode, every degree, 1, 3 and 7 channels, odd sizes, two cameras.
CASES = {
    "RGB": (cloud(), {}),
    "pixels that stop": (stacks(), {}),
    "RGB+D, degree 1, two cameras": (cloud(cameras=2, sh_degree=1), {"sh_degree": 1, "render_mode": "RGB+D"}),
    "RGB+ED, degree 2, 7 channels": (cloud(channels=7, sh_degree=2), {"sh_degree": 2, "render_mode": "RGB+ED"}),
    "D": (cloud(20, size=(17, 8), channels=1), {"render_mode": "D"}),
    "ED, one pixel": (cloud(20, size=(1, 1), channels=1), {"render_mode": "ED"}),
    "degree 0, one Gaussian": (cloud(1, size=(9, 7), sh_degree=0), {"sh_degree": 0}),
    "degree 3, 1 channel": (cloud(20, size=(9, 7), sh_degree=3, channels=1), {"sh_degree": 3}),
    "degree 4": (cloud(20, size=(9, 7), sh_degree=4), {"sh_degree": 4}),
}


def with_background_for_mode(scene, render_mode="RGB", **_):
    depth_channels = render_mode.startswith("RGB+")
    padded = jnp.pad(scene.backgrounds, ((0, 0), (0, depth_channels)), constant_values=0.5)
    return replace(scene, backgrounds=padded)


@pytest.mark.parametrize("name", CASES)
def test_tiles_equal_the_reference(name):
    scene, options = CASES[name]
    scene = with_background_for_mode(scene, **options)
    image, alphas, info, gradient = evaluate(scene, backend="xla", **options)
    expected_image, expected_alphas, _, expected_gradient = evaluate(scene, backend="reference", **options)
    assert not info["overflowed"]
    assert float(np.max(expected_alphas)) > 0.1
    assert_close(image, expected_image)
    assert_close(alphas, expected_alphas)
    # Measured up to 3e-6, and 3e-5 where two gradients of a field nearly cancel.
    for field, error in relative_errors(gradient, expected_gradient).items():
        assert error < 1e-4, (field, error)


@pytest.mark.parametrize("backend", ["xla", "reference"])
def test_an_empty_scene_is_its_background(backend):
    scene = cloud(0, cameras=2)
    image, alphas, info, gradient = evaluate(scene, backend=backend)
    np.testing.assert_array_equal(image, np.broadcast_to(scene.backgrounds[:, None, None], (2, 29, 37, 3)))
    np.testing.assert_array_equal(alphas, 0)
    assert gradient.means.shape == (0, 3)
    assert info["depths"].shape == (2, 0)
    assert backend == "reference" or (info["needed"] == 0 and not info["overflowed"])


def test_colours_may_differ_by_camera():
    scene = cloud(cameras=2)
    per_camera = replace(scene, colors=jnp.stack([scene.colors, 1 - scene.colors]))
    image = evaluate(per_camera, backend="xla")[0]
    for camera, colors in enumerate(per_camera.colors):
        assert_close(image[camera], evaluate(replace(scene, colors=colors), backend="xla")[0][camera])


def test_inria_rules_pass_the_gradient_straight_through_the_clamp():
    # Under opacity 0.35 the 3 sigma extent hides nothing that passes the cut: the tiles can equal the dense oracle.
    faint = cloud()
    faint = replace(faint, opacities=faint.opacities.at[1:].multiply(0.35).at[0].set(1.0))
    faint = replace(faint, means=faint.means.at[0].set(jnp.array([0.0, 0.0, 1.5])), scales=faint.scales.at[0].set(0.4))
    _, _, _, straight = evaluate(faint, backend="xla", rules=INRIA)
    _, _, _, expected = evaluate(faint, backend="reference", rules=INRIA)
    for field, error in relative_errors(straight, expected).items():
        assert error < 1e-4, (field, error)
    _, _, _, blocked = evaluate(faint, backend="xla")
    assert abs(straight.opacities[0] - blocked.opacities[0]) > 0.01 * abs(blocked.opacities[0])


def test_the_tiles_refuse_forward_mode():
    scene = cloud()
    with pytest.raises(TypeError, match="forward-mode"):
        jax.jvp(lambda c: render(replace(scene, colors=c))[0], (scene.colors,), (scene.colors,))
