"""What the tile backends do beside the hard cases: no Gaussian, harmonics, depths, another preset, what is in front."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import BACKENDS, GAUSSIAN_FIELDS, OWN, binned, cloud, evaluate, render, single
from tolerances import assert_close

from rasterizer import GSPLAT, INRIA, Front, _reference, blend, spherical_harmonics

pytestmark = pytest.mark.device


@pytest.mark.parametrize("backend", ["native", "xla", "reference"])
def test_an_empty_scene_is_its_background(backend):
    scene = cloud(0, cameras=2)
    image, alphas, info, gradient = evaluate(scene, backend=backend)
    np.testing.assert_array_equal(image, np.broadcast_to(scene.backgrounds[:, None, None], (2, 29, 37, 3)))
    np.testing.assert_array_equal(alphas, 0)
    assert gradient.means.shape == (0, 3)
    assert info["depths"].shape == (2, 0)
    assert backend == "reference" or (info["needed"] == 0 and not info["overflowed"])


def test_colours_may_differ_between_cameras():
    scene = cloud(cameras=2)
    colors = jnp.stack([scene.colors, 1 - scene.colors])
    image = render(replace(scene, colors=colors), capacity=2048)[0]
    alike = [evaluate(replace(scene, colors=each), OWN)[0][i] for i, each in enumerate(colors)]
    assert_close(image, jnp.stack(alike))


def test_harmonics_are_colours_by_direction():
    degree = 1
    scene = cloud(sh_degree=degree)
    camera = jnp.asarray(-np.asarray(scene.viewmats[0, :3, :3]).T @ np.asarray(scene.viewmats[0, :3, 3]))
    colors = jnp.maximum(spherical_harmonics(degree, scene.means - camera[None], scene.colors) + 0.5, 0)
    image = render(scene, sh_degree=degree, capacity=2048)[0]
    assert_close(image, evaluate(replace(scene, colors=colors), backend="xla")[0])


def test_depth_modes_are_the_depths_as_a_colour():
    scene = replace(cloud(), backgrounds=jnp.zeros((1, 3)))
    _, alphas, info, _ = evaluate(scene, backend="xla")
    depths = jnp.repeat(info["depths"][0, :, None], 3, -1)
    expected = np.asarray(evaluate(replace(scene, colors=depths), backend="xla")[0][..., :1])
    without_background = replace(scene, backgrounds=None)
    assert_close(render(without_background, render_mode="D", capacity=2048)[0], expected)
    # Divided by alpha, and 0 where nothing shows.
    is_covered = np.asarray(alphas) > 0
    assert np.any(~is_covered)
    normalised = render(without_background, render_mode="ED", capacity=2048)[0]
    assert_close(normalised, np.where(is_covered, expected / np.where(is_covered, alphas, 1), 0))


def layers(count, opacity):
    """So many wide splats one behind the other, the same alpha each, and their lists."""
    one = single(scale=(400.0, 400.0, 0.1), opacity=opacity)
    rows = {name: jnp.repeat(getattr(one, name), count, 0) for name in GAUSSIAN_FIELDS}
    ahead = 1e-3 * jnp.arange(count, dtype=jnp.float32)[:, None] * jnp.array([[0, 0, 1.0]])
    return replace(one, **rows | {"means": rows["means"] + ahead})


@pytest.mark.parametrize(("backend", "stop_after"), [(OWN, 0.0), *((each, 0.3) for each in BACKENDS)])
def test_what_is_in_front_is_the_light_above_a_level(backend, stop_after):
    """Of four layers of alpha 0.6, each leaves 0.4 of the light: what each layer adds to its own channel."""
    scene = layers(4, opacity=0.6)
    projection, grid, pairs = binned(scene, 16)
    front, each = Front(4, stop_after), jnp.eye(4)[None]
    if backend == "reference":
        image, *_ = _reference.composite(
            projection, scene.opacities[None], each, grid.width, grid.height, GSPLAT, front
        )
    else:
        image, *_ = blend(projection, scene.opacities, each, pairs, grid, backend=backend, front=front)
    levels = np.maximum(0.4 ** np.arange(5), stop_after)
    expected = np.broadcast_to(levels[:-1] - levels[1:], image.shape)
    assert_close(image, expected, rtol=0, atol=1e-5, why="wide splats fall off a little")


@pytest.mark.parametrize(("rules", "slope"), [(INRIA, 1.0), (GSPLAT, 0.0)], ids=["INRIA", "GSPLAT"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_inria_rules_pass_the_gradient_straight_through_the_clamp(backend, rules, slope):
    """One wide splat of opacity 1 has alpha 1 in all pixels, over the clamp at 0.99."""
    scene = layers(1, opacity=1.0)
    projection, grid, pairs = binned(scene, 16)

    @jax.jit
    @jax.value_and_grad
    def mean(opacities):
        image, *_ = blend(projection, opacities, jnp.ones((1, 1, 1)), pairs, grid, rules, backend=backend)
        return jnp.mean(image)

    assert_close(mean(scene.opacities), (0.99, np.array([slope])), rtol=1e-4, why="a wide splat falls off a little")


MOST = 900


@pytest.fixture(scope="module", params=["native", "xla", "pallas"])
def covered(request):
    """The mean of what layers of given opacities cover in front, and its slopes; one program for all cases."""

    @jax.jit
    @jax.value_and_grad
    def mean_in_front(opacities):
        scene = replace(layers(MOST, 0.5), opacities=jax.lax.stop_gradient(opacities))
        projection, grid, pairs = binned(scene, 16)
        ones = jnp.ones((1, MOST, 1))
        image, *_ = blend(projection, opacities, ones, pairs, grid, backend=request.param, front=Front(1, 0.2))
        return jnp.mean(image)

    return mean_in_front


@pytest.mark.parametrize(
    ("count", "opacity", "slope"),
    [
        (1, 1.0, 0.0),  # more than is left: how opaque it is no longer matters
        (3, 0.0, 0.0),  # nothing shows
        (900, 0.0045, 0.0),  # hardly above the cut; the light is used up after 357
        (300, 0.0045, None),  # the level is not reached
        (1, 0.8, None),  # the level is met exactly: a kink
    ],
)
def test_hard_cases_in_front(covered, count, opacity, slope):
    """The share of light is known, and finite slopes with it: of all opacities together, per one of them."""
    value, gradient = covered(jnp.zeros(MOST).at[:count].set(opacity))
    gradient = gradient[:count]
    left = (1 - min(opacity, 0.99)) ** count
    assert_close(value, 1 - max(left, 0.2), rtol=0, atol=2e-5, why="wide splats fall off a little; 900 roundings")
    assert np.isfinite(gradient).all()
    if slope is not None:
        assert_close(gradient, jnp.full(count, slope), rtol=0, atol=1e-4, why="hundreds of sums cancel")
    elif count > 1:
        assert_close(gradient, jnp.full(count, left / (1 - opacity)), rtol=1e-3, why="300 divisions back to front")
    else:
        assert 0 <= float(gradient[0]) <= 1.001, "either side's"
