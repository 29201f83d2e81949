"""Forward mode, second order and Gauss-Newton products through the reference, in float64; and the page about them."""

import re
from dataclasses import fields, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scenes import NO_THRESHOLDS, in_float64, render, smooth

PAGE = Path(__file__).resolve().parents[2] / "docs" / "differentiation.md"
FIELDS = [f.name for f in fields(smooth()) if not f.metadata]


def image_of(scene, **arrays):
    image, alphas, _ = render(replace(scene, **arrays), backend="reference", rules=NO_THRESHOLDS)
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


@pytest.mark.long
def test_a_hessian_is_symmetric_and_gives_the_products(x64):
    scene = in_float64(smooth())

    def objective(means):
        return jnp.sum(image_of(scene, means=means) ** 2)

    hessian = np.asarray(jax.jit(jax.hessian(objective))(scene.means)).reshape(12, 12)
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-9)
    direction = jnp.asarray(np.random.default_rng(1).normal(size=(4, 3)))
    _, product = jax.jvp(jax.grad(objective), (scene.means,), (direction,))
    np.testing.assert_allclose(product.ravel(), hessian @ np.asarray(direction).ravel(), rtol=1e-9)


@pytest.mark.long
def test_gauss_newton_products_without_the_jacobian(x64):
    scene = in_float64(smooth())

    def image(cameras):
        viewmats, Ks = cameras
        return image_of(scene, viewmats=viewmats, Ks=Ks)

    point = scene.viewmats, scene.Ks
    rng = np.random.default_rng(2)
    direction = tuple(jnp.asarray(rng.normal(size=x.shape)) for x in point)
    _, forward = jax.linearize(image, point)
    _, backward = jax.vjp(image, point)
    product = jnp.concatenate([x.ravel() for x in backward(forward(direction))[0]])
    J = jnp.concatenate([x.reshape(5 * 6 * 3, -1) for x in jax.jacrev(image)(point)], -1)
    flat = jnp.concatenate([x.ravel() for x in direction])
    np.testing.assert_allclose(product, J.T @ (J @ flat), rtol=1e-9, atol=1e-12)


def test_the_page_finds_the_pose(capsys):
    programs = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (program,) = (each for each in programs if "errors" in each)
    names = {}
    exec(program, names)
    errors = names["errors"]
    assert errors[0] > 1e-3 and errors[-1] < 1e-5
    # What the page says it prints; the last digits belong to the machine.
    printed = re.search(r"after each step:\n\n    (.*)\n", PAGE.read_text()).group(1).split()
    assert len(printed) == len(capsys.readouterr().out.split()) == 8
    np.testing.assert_allclose(np.log10(errors[:3]), np.log10([float(p) for p in printed[:3]]), atol=0.5)
