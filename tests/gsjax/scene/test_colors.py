"""sRGB against the standard's own numbers, and one function for numpy and JAX."""

import jax
import jax.numpy as jnp
import numpy as np

from gsjax.scene.colors import linear_to_srgb, srgb_to_linear

CODES = np.linspace(0, 1, 256)


def test_light_of_a_code_comes_back_and_a_middle_grey_is_the_standards():
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(CODES)), CODES, atol=1e-7)
    np.testing.assert_allclose(
        srgb_to_linear(np.array([0.0, 0.04045, 0.5, 1.0])), [0, 0.0031308, 0.2140411, 1], atol=1e-7
    )


def test_numpy_stays_numpy_and_jax_differentiates_at_black():
    light = srgb_to_linear(CODES)
    assert isinstance(light, np.ndarray) and light.dtype == np.float64
    np.testing.assert_allclose(srgb_to_linear(jnp.asarray(CODES, jnp.float32)), light, atol=1e-6)
    np.testing.assert_allclose(jax.grad(lambda x: linear_to_srgb(x))(jnp.float32(0)), 12.92, rtol=1e-6)
