from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import jax.test_util
import numpy as np
import pytest
import scipy.special
from jaxprs import equations
from tolerances import assert_close

from rasterizer import harmonics, spherical_harmonics, upper_bands


def unit_directions(count=50):
    directions = np.random.default_rng(0).normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def real_harmonic(degree, order, directions):
    """Real spherical harmonic made of scipy's complex ones, in the convention of 3DGS.

    scipy has the Condon-Shortley phase; without it the real harmonics are sqrt(2) (-1)^m Re or Im, and 3DGS keeps it,
    so that the (-1)^m falls away again.
    """
    x, y, z = directions.T
    value = scipy.special.sph_harm_y(degree, abs(order), np.arccos(z), np.arctan2(y, x))
    if order == 0:
        return value.real
    return np.sqrt(2) * (value.imag if order < 0 else value.real)


@pytest.mark.parametrize("degree", range(5))
def test_every_basis_function_against_scipy(degree, x64):
    directions = unit_directions()
    count = (degree + 1) ** 2
    basis = spherical_harmonics(degree, jnp.asarray(directions), jnp.eye(count, dtype=jnp.float64)[None])
    expected = [real_harmonic(d, m, directions) for d in range(degree + 1) for m in range(-d, d + 1)]
    assert_close(basis, np.stack(expected, -1), rtol=0, atol=1e-12, why="zeros are compared; constants have 16 digits")


@pytest.mark.parametrize("degree", [0, 2])
def test_weights_leave_out_upper_bands_and_their_gradients(degree):
    rng = np.random.default_rng(4)
    directions, coeffs = rng.normal(size=(8, 3)), rng.normal(size=(8, 15, 3))
    directions, coeffs = jnp.asarray(directions, jnp.float32), jnp.asarray(coeffs, jnp.float32)
    weights = jnp.asarray(np.arange(1, 16) < (degree + 1) ** 2, jnp.float32)

    def cut(directions, coeffs):
        return upper_bands(directions, coeffs[:, : (degree + 1) ** 2 - 1])

    assert_close(upper_bands(directions, coeffs, weights), cut(directions, coeffs))
    whole = jax.jit(jax.grad(lambda *x: jnp.sum(jnp.sin(upper_bands(*x))), (0, 1)))
    gradients = whole(directions, coeffs, weights)
    expected = jax.jit(jax.grad(lambda *x: jnp.sum(jnp.sin(cut(*x))), (0, 1)))(directions, coeffs)
    for got, reference in zip(gradients, expected, strict=True):
        assert_close(got, reference)


def test_only_a_cpu_sums_bands_by_a_product_of_matrices(monkeypatch):
    """The matrix units of a GPU round, and its products of small matrices are slow."""
    rng = np.random.default_rng(5)
    directions, coeffs = rng.normal(size=(8, 3)), rng.normal(size=(8, 16, 3))
    directions, coeffs = jnp.asarray(directions, jnp.float32), jnp.asarray(coeffs, jnp.float32)
    on_cpu = spherical_harmonics(3, directions, coeffs)
    monkeypatch.setattr(harmonics, "default_device", lambda: SimpleNamespace(platform="gpu"))
    program = jax.make_jaxpr(jax.grad(lambda *x: jnp.sum(spherical_harmonics(3, *x)), (0, 1)))(directions, coeffs)
    assert not any(equation.primitive.name == "dot_general" for equation in equations(program.jaxpr))
    assert_close(spherical_harmonics(3, directions, coeffs), on_cpu)


@jax.jit
@partial(jax.value_and_grad, argnums=(0, 1))
def of_degree_4(direction, coeffs):
    return jnp.sum(spherical_harmonics(4, direction, coeffs))


@pytest.mark.parametrize("length", [0.0, 1e-30, 1e30])
def test_extreme_lengths_have_finite_values_and_gradients(length):
    direction = jnp.asarray([[0.6 * length, 0.0, 0.8 * length]], jnp.float32)
    value, gradients = of_degree_4(direction, jnp.ones((1, 25, 1), jnp.float32))
    unit = np.array([[0.0, 0, 1]]) if length == 0 else np.array([[0.6, 0, 0.8]])
    expected = sum(real_harmonic(d, m, unit)[0] for d in range(5) for m in range(-d, d + 1))
    assert_close(value, expected, rtol=1e-5, atol=1e-5, why="a float32 sum of 25 terms")
    assert np.isfinite(gradients[0]).all() and np.isfinite(gradients[1]).all()
    if length == 0:
        np.testing.assert_array_equal(gradients[0], 0)


def test_gradient_against_finite_differences(x64):
    rng = np.random.default_rng(2)
    directions, coeffs = jnp.asarray(rng.normal(size=(4, 3))), jnp.asarray(rng.normal(size=(4, 25, 2)))
    jax.test_util.check_grads(
        jax.jit(lambda d, c: spherical_harmonics(4, d, c)), (directions, coeffs), order=1, atol=1e-6, rtol=1e-6
    )


def test_bands_above_the_degree_are_ignored():
    rng = np.random.default_rng(3)
    directions = jnp.asarray(rng.normal(size=(5, 3)), jnp.float32)
    coeffs = jnp.asarray(rng.normal(size=(5, 25, 3)), jnp.float32)
    few = spherical_harmonics(2, directions, coeffs[:, :9])
    np.testing.assert_array_equal(spherical_harmonics(2, directions, coeffs), few)
    gradient = jax.jit(jax.grad(lambda c: jnp.sum(spherical_harmonics(2, directions, c))))(coeffs)
    np.testing.assert_array_equal(gradient[:, 9:], 0)
