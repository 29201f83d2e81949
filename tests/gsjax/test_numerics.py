import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tolerances import assert_close

from gsjax.numerics import masked_mean, safe_divide, safe_normalize, times

JACOBIAN = jax.jit(jax.jacobian(safe_normalize))


def test_normalized_vectors_are_unit_and_parallel():
    v = np.random.default_rng(0).normal(size=(4, 5, 3)) * np.logspace(-5, 15, 5)[None, :, None]
    assert_close(safe_normalize(jnp.asarray(v, jnp.float32)), v / np.linalg.norm(v, axis=-1, keepdims=True))


@pytest.mark.parametrize("v", [(0.0, 0.0, 0.0), (1e-30, 1e-38, -1e-42)])
def test_a_vector_too_short_gives_zero_with_zero_gradient(v):
    v = jnp.asarray(v, jnp.float32)
    assert_close(safe_normalize(v), np.zeros(3))
    assert_close(JACOBIAN(v), np.zeros((3, 3)))


def test_gradient_of_normalize_is_the_projector(x64):
    v = jnp.asarray([0.3, -1.2, 0.4])
    unit = np.asarray(v) / np.linalg.norm(v)
    assert_close(JACOBIAN(v), (np.eye(3) - np.outer(unit, unit)) / np.linalg.norm(v))


def test_division_where_it_is_usable():
    top, bottom = jnp.asarray([1.0, 2.0, 3.0]), jnp.asarray([4.0, 0.0, jnp.nan])
    usable = jnp.asarray([True, False, False])
    assert_close(safe_divide(top, bottom, usable), np.array([0.25, 0, 0]))
    by_top, by_bottom = jax.grad(lambda a, b: safe_divide(a, b, usable).sum(), argnums=(0, 1))(top, bottom)
    assert_close(by_top, np.array([0.25, 0, 0]))
    assert_close(by_bottom, np.array([-1 / 16, 0, 0]))


def test_masked_mean_is_the_mean_of_what_counts_and_zero_of_nothing():
    values = np.random.default_rng(1).normal(size=(6, 7)).astype(np.float32)
    mask = np.random.default_rng(2).random((6, 7)) > 0.4
    for counts, mean, slopes in ((mask, values[mask].mean(), mask / mask.sum()), (0 * mask > 0, 0.0, 0.0 * mask)):
        got, gradient = jax.value_and_grad(masked_mean)(jnp.asarray(values), jnp.asarray(counts))
        assert_close(got, mean)
        assert_close(gradient, slopes)


def test_a_product_is_that_of_the_matrix_with_its_gradients(x64):
    rng = np.random.default_rng(0)
    matrix, vectors, slopes = rng.normal(size=(3, 3)), rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    products, back = jax.vjp(jax.vmap(times, in_axes=(None, 0)), jnp.asarray(matrix), jnp.asarray(vectors))
    assert_close(products, vectors @ matrix.T)
    assert_close(back(jnp.asarray(slopes)), (slopes.T @ vectors, slopes @ matrix), kind="gradient")
