"""Finite gradients and `rasterizer.adam`, as loops and in jnp, next to Adam in float64."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tolerances import assert_close

import rasterizer
from rasterizer import Moments

BACKENDS = pytest.mark.parametrize("backend", ["native", "xla"])
SHAPES = [(0,), (5, 2, 3), (20_011,)]  # the last is more than one block of a thread
RATE, EPS = 0.02, 1e-15


def gradients_of(shape, steps):
    """Gradients of many magnitudes, some of them zero, one of them zero in every step."""
    rng = np.random.default_rng(len(shape))
    values = rng.normal(size=(steps, *shape)) * 10.0 ** rng.uniform(-12, 4, (steps, *shape))
    values[rng.uniform(size=values.shape) < 0.1] = 0
    values.reshape(steps, -1)[:, :1] = 0
    return values.astype(np.float32)


step = jax.jit(partial(rasterizer.adam, rate=RATE), donate_argnums=(0, 2), static_argnames="backend")


def stepped(backend, parameters, gradients, skipped=False):
    """Parameters and moments after steps from zero moments."""
    zeros = jnp.zeros_like(parameters)
    moments = Moments(zeros, jnp.zeros_like(zeros))
    for count, gradient in enumerate(gradients, 1):
        how = {"count": jnp.int32(count), "backend": backend}
        parameters, moments = step(parameters, gradient, moments, jnp.bool_(skipped), **how)
    return parameters, moments


def in_float64(parameters, gradients):
    mu, nu = np.zeros(parameters.shape), np.zeros(parameters.shape)
    for count, gradient in enumerate(gradients.astype(np.float64), 1):
        mu, nu = 0.9 * mu + 0.1 * gradient, 0.999 * nu + 0.001 * gradient**2
        parameters = parameters - RATE * (mu / (1 - 0.9**count)) / (np.sqrt(nu / (1 - 0.999**count)) + EPS)
    return parameters, Moments(mu, nu)


def assert_alike(moments, expected, gradients):
    """Beside the largest gradient of each number: sums of terms of both signs cancel."""
    largest = np.maximum(np.abs(gradients).max(0, initial=0), 1e-30)
    for one, other, scale in zip(moments, expected, (largest, largest.astype(np.float64) ** 2), strict=True):
        ratios = (np.asarray(each, np.float64) / scale for each in (one, other))
        assert_close(*ratios, rtol=0, atol=3e-7, why="a few roundings of float32")


@BACKENDS
@pytest.mark.parametrize("shape", SHAPES)
def test_steps_are_those_in_float64_and_have_the_same_bits_again(backend, shape):
    parameters = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    gradients = gradients_of(shape, 4)
    actual, moments = stepped(backend, jnp.array(parameters), gradients)
    again, _ = stepped(backend, jnp.array(parameters), gradients)
    np.testing.assert_array_equal(again, actual)
    expected, of_float64 = in_float64(parameters.astype(np.float64), gradients)
    why = "four roundings of float32; 1 - 0.999 ** count loses three digits"
    assert_close(actual - parameters, (expected - parameters).astype(np.float32), rtol=1e-4, atol=1e-6, why=why)
    assert_alike(moments, of_float64, gradients)
    if parameters.size:
        assert actual.reshape(-1)[0] == parameters.reshape(-1)[0], "no gradient, no step"


@BACKENDS
def test_a_skipped_step_changes_no_bit_whatever_the_gradient(backend):
    parameters = jnp.asarray([1.5, -0.0, 2.0, 3.0], jnp.float32)
    gradient = np.array([[1.0, np.nan, np.inf, -np.inf]], np.float32)
    actual, moments = stepped(backend, jnp.copy(parameters), gradient, skipped=True)
    assert actual.tobytes() == parameters.tobytes()
    assert not np.any(moments.mu) and not np.any(moments.nu)


@BACKENDS
def test_one_number_that_is_not_finite_is_found_wherever_it_stands(backend):
    all_finite = jax.jit(partial(rasterizer.all_finite, backend=backend))
    numbers = jnp.asarray(np.random.default_rng(0).normal(size=49_999) * 1e30, jnp.float32)
    tree = {"rows": numbers.reshape(-1, 1), "count": jnp.int32(7), "one": jnp.float32(3), "none": jnp.zeros((0, 3))}
    assert all_finite(tree)
    for bad, place in ((np.nan, 0), (np.inf, 16_384), (-np.inf, 49_998)):
        assert not all_finite({**tree, "rows": tree["rows"].at[place].set(bad)})
        assert not all_finite({**tree, "one": jnp.float32(bad)})
    largest = np.full(1000, np.finfo(np.float32).max)
    assert rasterizer.all_finite((largest, -largest), backend=backend)
    assert rasterizer.all_finite((), backend=backend)
    assert rasterizer.all_finite({"whole": np.arange(3)}, backend=backend)
