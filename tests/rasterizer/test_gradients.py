"""Derivatives against finite differences, of any order by the reference."""

from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scenes import BACKENDS, NO_THRESHOLDS, in_float64, loss, render, smooth, textbook

import rasterizer

FIELDS = [f.name for f in fields(smooth()) if not f.metadata]
STEP = 1e-6
OTHERS = [each for each in BACKENDS if each != "native"]


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


# Of planes with so little room before the near plane that some are made flatter.
DEPTHS = {"center": {}, "plane, some flatter": {"depth_mode": "plane", "near_plane": 1.5}}


def objective(scene, depth="center"):
    return loss(scene, backend="reference", render_mode="RGB+ED", rules=NO_THRESHOLDS, **DEPTHS[depth])[0]


value_and_gradient = jax.jit(jax.value_and_grad(objective), static_argnums=1)


def difference(function, scene, direction):
    """Central difference of a function of a scene along a direction."""
    forward, backward = (jax.tree.map(lambda x, d, h=h: x + h * d, scene, direction) for h in (STEP, -STEP))
    return jax.tree.map(lambda a, b: (a - b) / (2 * STEP), function(forward), function(backward))


def dot(a, b):
    return sum(jnp.vdot(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


@pytest.mark.parametrize("depth", ["plane, some flatter", pytest.param("center", marks=pytest.mark.long)])
def test_reverse_mode_against_central_differences(x64, scene, directions, depth):
    gradient = value_and_gradient(scene, depth)[1]
    for name in FIELDS:
        slope = difference(lambda s: value_and_gradient(s, depth)[0], scene, directions[name])
        assert abs(slope) > 1e-3
        np.testing.assert_allclose(dot(gradient, directions[name]), slope, rtol=1e-7, atol=1e-8, err_msg=name)


def test_some_planes_of_that_scene_are_made_flatter(x64, scene):
    _, depths, joint = textbook(scene)
    slopes = np.array([np.linalg.solve(S[:2, :2] + 0.3 * np.eye(2), S[:2, 2]) for S in joint])
    reach = 3.33 * np.sqrt(np.sum(slopes * joint[:, :2, 2], -1))
    assert 0 < (reach > depths - DEPTHS["plane, some flatter"]["near_plane"]).sum() < 4


def test_forward_mode_against_central_differences(x64, scene, directions):
    pushforward = jax.jit(lambda s, d: jax.jvp(objective, (s,), (d,)))
    for name in FIELDS:
        slope = difference(lambda s, d=directions[name]: pushforward(s, d)[0], scene, directions[name])
        assert abs(slope) > 1e-3
        np.testing.assert_allclose(pushforward(scene, directions[name])[1], slope, rtol=1e-7, atol=1e-8, err_msg=name)


def image_of(scene, **arrays):
    image, alphas, _ = render(replace(scene, **arrays), backend="reference", rules=rasterizer.SMOOTH)
    return jnp.concatenate([image, alphas], -1)


@pytest.mark.long
def test_both_modes_to_second_order(x64):
    scene = in_float64(smooth())
    # One random functional of the image: the checks difference it along random directions, in both modes and orders.
    weights = jnp.asarray(np.random.default_rng(0).normal(size=(1, 5, 6, 3)))
    functional = jax.jit(lambda arrays: jnp.sum(weights * image_of(scene, **arrays) ** 2))
    arrays = {name: getattr(scene, name) for name in FIELDS}
    for each in (functional, jax.jit(jax.grad(functional))):
        check_grads(each, (arrays,), order=1, modes=("fwd", "rev"), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("backend", ["native", *(pytest.param(each, marks=pytest.mark.long) for each in OTHERS)])
def test_every_splat_reaches_every_tile(backend):
    scene = replace(smooth(), scales=smooth().scales * 0.01, width=20, height=15)
    how = {"backend": backend, "capacity": 256, "tile_size": 4, "rules": rasterizer.SMOOTH}
    image, alphas, info = jax.jit(lambda scene: render(scene, **how))(scene)
    assert np.isfinite(image).all() and np.isfinite(alphas).all()
    assert info["visible"].all() and (info["radii"] > 10**9).all()
    if backend != "reference":
        np.testing.assert_array_equal(info["tiles_per_gauss"], np.full((1, 4), 20))
