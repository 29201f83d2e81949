from functools import partial

import jax
import jax.numpy as jnp
import jax.test_util
import numpy as np
import pytest
import scipy.special
from tolerances import assert_close

from rasterizer import spherical_harmonics, upper_bands


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


@pytest.mark.parametrize("degree", [1, 4])
def test_every_basis_function_against_scipy(degree, x64):
    directions = unit_directions()
    count = (degree + 1) ** 2
    basis = spherical_harmonics(degree, jnp.asarray(directions), jnp.eye(count, dtype=jnp.float64)[None])
    expected = [real_harmonic(d, m, directions) for d in range(degree + 1) for m in range(-d, d + 1)]
    assert_close(basis, np.stack(expected, -1), rtol=0, atol=1e-12, why="zeros are compared; constants have 16 digits")


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


LOOPS_AND_JNP = ["native", "xla"]


@partial(jax.jit, static_argnames="backend")
def with_pulled(directions, coeffs, weights, cotangents, backend):
    """Values, and cotangents pulled back to each argument."""
    values, pull = jax.vjp(partial(upper_bands, backend=backend), directions, coeffs, weights)
    return values, *pull(cotangents)


@pytest.mark.parametrize(
    ("backend", "bands", "rows_of_weights", "count"),
    [
        ("native", 3, 0, 1),
        ("native", 8, 1, 1100),
        ("native", 15, 2, 1100),
        ("xla", 15, 2, 1100),
    ],
)
def test_upper_bands_and_their_gradients_against_float64(backend, bands, rows_of_weights, count):
    """One row, and more than a thread takes at a time with a part of a strip and a direction of length zero."""
    rng = np.random.default_rng(bands)
    directions, coeffs = rng.normal(size=(count, 3)) * 3.0, rng.normal(size=(count, bands, 3))
    directions[count // 2] = 0 if count > 1 else 1
    shape = {0: None, 1: (bands,), 2: (count, bands)}[rows_of_weights]
    weights, cotangents = (shape and rng.normal(size=shape)), rng.normal(size=(count, 3))
    arguments = [each if each is None else np.float32(each) for each in (directions, coeffs, weights, cotangents)]
    values = with_pulled(*arguments, backend=backend)
    with jax.enable_x64(True):
        exact = [each if each is None else np.float64(each) for each in arguments]
        expected = with_pulled(*exact, backend="reference")
    assert_close(values, expected, rtol=1e-5, atol=1e-5, why="float32 sums of 45 terms of size 1")
    if count > 1:
        np.testing.assert_array_equal(values[1][count // 2], 0)


@pytest.mark.parametrize("length", [1e-33, 1e30, 3e38])
def test_upper_bands_of_extreme_lengths(length):
    unit, coeffs = np.float32(unit_directions(40)), np.float32(np.random.default_rng(7).normal(size=(40, 15, 3)))
    ones = np.ones((40, 3), np.float32)
    values, gradient, *_ = with_pulled(unit * np.float32(length), coeffs, None, ones, "native")
    expected, scaled, *_ = with_pulled(unit, coeffs, None, ones, "reference")
    assert_close(values, expected)
    assert np.isfinite(gradient).all()
    if length < 1e38:  # Past it a gradient is a denormal number, which a processor may take for 0.
        assert_close(gradient * np.float32(length), scaled, kind="gradient")


@pytest.mark.parametrize("backend", LOOPS_AND_JNP)
def test_what_is_not_finite_stays_in_its_row(backend):
    rng = np.random.default_rng(8)
    directions, coeffs = rng.normal(size=(40, 3)).astype(np.float32), rng.normal(size=(40, 15, 3)).astype(np.float32)
    bad_directions, bad_coeffs = directions.copy(), coeffs.copy()
    bad_directions[3], bad_coeffs[17, 4, 1], bad_coeffs[25] = np.nan, np.inf, np.inf
    others = np.setdiff1d(np.arange(40), [3, 17, 25])
    cotangents = np.ones((40, 3), np.float32)
    cotangents[25] = 0

    def both(directions, coeffs):
        return with_pulled(directions, coeffs, None, cotangents, backend)[:3]

    bad_results = both(bad_directions, bad_coeffs)
    for bad, good in zip(bad_results, both(directions, coeffs), strict=True):
        np.testing.assert_array_equal(bad[others], good[others])
    assert np.isnan(bad_results[0][3]).all()
    if backend == "native":
        assert not any(np.any(gradient[25]) for gradient in bad_results[1:]), "nothing depends on that row"


def test_forward_mode_of_the_loops_is_an_error_and_of_the_reference_is_not():
    directions, coeffs = jnp.ones((2, 3)), jnp.ones((2, 15, 3))
    with pytest.raises(TypeError, match="backend='reference'"):
        jax.jit(lambda *x: jax.jvp(upper_bands, x, x)[1])(directions, coeffs)
    _, tangent = jax.jvp(partial(upper_bands, backend="reference"), (directions, coeffs), (directions, coeffs))
    assert_close(tangent, upper_bands(directions, coeffs))  # Linear in coefficients; along a direction nothing changes.


@pytest.mark.parametrize("backend", LOOPS_AND_JNP)
def test_without_upper_bands_values_are_zero_and_no_rows_have_none(backend):
    for weights in (None, jnp.ones((1, 0))):
        values = upper_bands(jnp.ones((5, 3)), jnp.zeros((5, 0, 3)), weights, backend=backend)
        np.testing.assert_array_equal(values, np.zeros((5, 3)))
    assert upper_bands(jnp.zeros((0, 3)), jnp.zeros((0, 15, 3)), backend=backend).shape == (0, 3)
