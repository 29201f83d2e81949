"""Derivatives of the dense reference against finite differences, and of the tiles where pixels stop early."""

from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import NO_THRESHOLDS, cloud, evaluate, in_float64, loss, relative_errors, smooth, stacks

from rasterizer import _reference, project

FIELDS = [f.name for f in fields(smooth()) if not f.metadata]
STEP = 1e-6


@pytest.fixture(scope="module")
def scene():
    with jax.enable_x64(True):
        s = in_float64(smooth())
        return replace(s, backgrounds=jnp.pad(s.backgrounds, ((0, 0), (0, 1)), constant_values=0.5))


@pytest.fixture(scope="module")
def directions(scene):
    """One random direction per field, the others at rest: no field hides behind a larger one."""
    rng = np.random.default_rng(11)
    with jax.enable_x64(True):
        zero = jax.tree.map(jnp.zeros_like, scene)
        return {n: replace(zero, **{n: jnp.asarray(rng.normal(size=getattr(scene, n).shape))}) for n in FIELDS}


# Of planes, the last time with so little room before the near plane that some are made flatter.
DEPTHS = {
    "center": {},
    "plane": {"depth_mode": "plane"},
    "plane, flatter": {"depth_mode": "plane", "near_plane": 1.5},
}


def objective(scene, depth="center"):
    return loss(scene, backend="reference", render_mode="RGB+ED", rules=NO_THRESHOLDS, **DEPTHS[depth])[0]


first_derivative = jax.jit(jax.grad(objective), static_argnums=1)


def difference(function, scene, direction):
    """Central difference of a function of a scene along a direction."""
    forward, backward = (jax.tree.map(lambda x, d, h=h: x + h * d, scene, direction) for h in (STEP, -STEP))
    return jax.tree.map(lambda a, b: (a - b) / (2 * STEP), function(forward), function(backward))


def dot(a, b):
    return sum(jnp.vdot(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("depth", ["center", pytest.param("plane", marks=pytest.mark.long), "plane, flatter"])
def test_reverse_mode_against_central_differences(x64, scene, directions, depth, name):
    value = jax.jit(objective, static_argnums=1)
    slope = difference(lambda s: value(s, depth), scene, directions[name])
    assert abs(slope) > 1e-3
    np.testing.assert_allclose(dot(first_derivative(scene, depth), directions[name]), slope, rtol=1e-7, atol=1e-8)


def test_some_planes_of_that_scene_are_made_flatter(x64, scene):
    s = scene

    def slopes(near_plane):
        cameras = s.viewmats, s.Ks, s.width, s.height
        return project(s.means, s.quats, s.scales, s.opacities, *cameras, depth_mode="plane", near_plane=near_plane)

    free, bounded = (slopes(near).slopes[0] for near in (0.01, 1.5))
    flatter = np.linalg.norm(bounded, axis=-1) < 0.999 * np.linalg.norm(free, axis=-1)
    assert 0 < flatter.sum() < 4


def test_forward_mode_equals_reverse_mode(x64, scene, directions):
    gradient = first_derivative(scene)
    pushforward = jax.jit(lambda s, d: jax.jvp(objective, (s,), (d,))[1])
    for name in FIELDS:
        np.testing.assert_allclose(pushforward(scene, directions[name]), dot(gradient, directions[name]), rtol=1e-10)


def projected(s):
    """The scene's splats, and a scalar of all that is differentiable in them."""
    p = project(s.means, s.quats, s.scales, s.opacities, s.viewmats, s.Ks, s.width, s.height, rules=NO_THRESHOLDS)
    return p, sum(jnp.sum(jnp.sin(x)) for x in (p.means2d, p.depths, p.conics))


def assert_second_order(function, inputs, direction):
    """Forward over reverse against central differences of the gradient, along one direction."""
    # Not compiled: op by op is several times faster for so few numbers.
    expected = difference(jax.grad(function), inputs, direction)
    product = jax.jvp(jax.grad(function), (inputs,), (direction,))[1]
    error = jax.tree.map(jnp.subtract, product, expected)
    assert np.sqrt(dot(error, error)) < 1e-7 * np.sqrt(dot(expected, expected))
    return product


@pytest.mark.long
def test_second_order_of_the_projection(x64, scene, directions):
    everywhere = jax.tree.map(lambda *x: sum(x), *directions.values())
    assert_second_order(lambda s: projected(s)[1], scene, everywhere)


@pytest.mark.long
def test_second_order_of_the_blend_in_both_modes(x64, scene):
    projection = projected(scene)[0]
    features = jnp.concatenate([scene.colors, projection.depths[0, :, None]], -1)
    inputs = projection.means2d, projection.conics, scene.opacities[None], features[None]

    def blended(inputs):
        means2d, conics, opacities, features = inputs
        splats = projection._replace(means2d=means2d, conics=conics)
        image, left, _ = _reference.composite(splats, opacities, features, scene.width, scene.height, NO_THRESHOLDS)
        return jnp.sum(image**2) + jnp.sum(left)

    rng = np.random.default_rng(12)
    direction = tuple(jnp.asarray(rng.normal(size=x.shape)) for x in inputs)
    product = assert_second_order(blended, inputs, direction)
    twice_reversed = jax.grad(lambda x: dot(jax.grad(blended)(x), direction))(inputs)
    for actual, expected in zip(twice_reversed, product, strict=True):
        np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("make_scene", [cloud, stacks])
@pytest.mark.parametrize("backend", ["xla", "reference"])
def test_float32_against_the_float64_reference(make_scene, backend):
    scene = make_scene()
    image, alphas, _, gradient = evaluate(scene, backend)
    with jax.enable_x64(True):
        expected_image, expected_alphas, _, expected = evaluate(in_float64(scene), "reference")
    np.testing.assert_allclose(image, expected_image, atol=3e-6)
    np.testing.assert_allclose(alphas, expected_alphas, atol=3e-6)
    for field, error in relative_errors(gradient, expected).items():
        assert error < 2e-5, (field, error)


def test_most_pixels_of_the_stacks_stop_early():
    scene = stacks()
    alphas, info = evaluate(scene, "xla")[1:3]
    assert np.mean(np.asarray(alphas) > 0.99) > 0.5
    # Far more is listed than a pixel needs to stop.
    lengths = np.diff(np.asarray(info["offsets"]))
    assert np.median(lengths) > 15


def test_what_no_pixel_sees_has_exactly_zero_gradient():
    scene = cloud()
    _, _, info, gradient = evaluate(scene, "xla")
    listed = np.zeros(scene.means.shape[0], bool)
    listed[np.asarray(info["splats"])[: int(info["offsets"][-1])]] = True
    assert 0 < (~listed).sum() < listed.size
    for name in ("means", "quats", "scales", "opacities", "colors"):
        rows = np.asarray(getattr(gradient, name)).reshape(listed.size, -1)
        np.testing.assert_array_equal(rows[~listed], 0)
        assert np.all(np.abs(rows[listed]).sum(-1) > 0) or name == "scales"
