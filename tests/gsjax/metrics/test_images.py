import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import correlate1d

from gsjax.metrics import images as measures
from gsjax.metrics.images import psnr
from rasterizer import similarity

# Compiled whole: op by op every shape would compile a dozen programs.
ssim, ssim_map = jax.jit(measures.ssim), jax.jit(similarity.ssim_map)


@pytest.fixture(scope="module")
def images():
    """A smooth target and a disturbed copy, float64, of odd sizes and not square."""
    rng = np.random.default_rng(3)
    target = correlate1d(rng.random((37, 52, 3)), np.full(5, 0.2), axis=0)
    return np.clip(target + 0.1 * rng.standard_normal(target.shape), 0.0, 1.0), target


def ssim_oracle(image, target):
    """The textbook form with two variances and a covariance, by scipy, zeros beyond the border."""
    window = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    window /= window.sum()

    def blur(x):
        return correlate1d(correlate1d(x, window, axis=0, mode="constant"), window, axis=1, mode="constant")

    mean_x, mean_y = blur(image), blur(target)
    var_x, var_y = blur(image**2) - mean_x**2, blur(target**2) - mean_y**2
    covariance = blur(image * target) - mean_x * mean_y
    numerator = (2 * mean_x * mean_y + 1e-4) * (2 * covariance + 9e-4)
    return numerator / ((mean_x**2 + mean_y**2 + 1e-4) * (var_x + var_y + 9e-4))


def as_float32(*arrays):
    return tuple(jnp.asarray(a, jnp.float32) for a in arrays)


def test_ssim_is_the_mean_of_the_textbook_form_and_reads_masked_pixels_as_zero(images):
    image, target = images
    np.testing.assert_allclose(ssim_map(*as_float32(*images)), ssim_oracle(*images), atol=2e-5)
    np.testing.assert_allclose(ssim(*as_float32(*images)), ssim_oracle(*images).mean(), rtol=1e-5)
    mask = np.random.default_rng(0).random(image.shape[:2]) > 0.3
    expected = ssim_oracle(image * mask[..., None], target * mask[..., None])[mask].mean()
    np.testing.assert_allclose(ssim(*as_float32(image, target), jnp.asarray(mask)), expected, rtol=1e-5)


def test_masked_pixels_cannot_matter_even_when_not_finite(images):
    image, target = as_float32(*images)
    mask = jnp.asarray(np.random.default_rng(0).random(image.shape[:2]) > 0.3)
    poisoned = jnp.where(mask[..., None], image, jnp.float32(jnp.nan))
    for measure in (ssim, psnr):
        value, gradient = jax.value_and_grad(measure)(poisoned, target, mask)
        np.testing.assert_allclose(value, measure(image, target, mask), rtol=1e-6)
        assert np.all(np.asarray(gradient)[~np.asarray(mask)] == 0)


def test_psnr_equals_3dgs_formula(images):
    image, target = images
    for mask in (np.ones(image.shape[:2], bool), np.random.default_rng(1).random(image.shape[:2]) > 0.5):
        expected = 20 * np.log10(1 / np.sqrt(np.mean((image - target)[mask] ** 2)))
        np.testing.assert_allclose(psnr(*as_float32(image, target), jnp.asarray(mask)), expected, rtol=1e-6)
    assert psnr(*as_float32(target, target)) == jnp.inf


def test_equal_images(images):
    _, target = as_float32(*images)
    np.testing.assert_allclose(ssim(target, target), 1.0, atol=1e-6)
    gradient = jax.grad(ssim)(target, target)  # a maximum
    np.testing.assert_allclose(gradient, np.zeros_like(gradient), atol=1e-7)


def test_shapes_that_do_not_match_are_named():
    image = jnp.zeros((4, 5, 3), jnp.float32)
    for measure in (psnr, ssim):
        with pytest.raises(ValueError, match=r"\(4, 5, 3\).*\(5, 4, 3\)"):
            measure(image, jnp.zeros((5, 4, 3), jnp.float32))
        with pytest.raises(ValueError, match=r"\(5, 4\).*\(4, 5, 3\)"):
            measure(image, image, jnp.ones((5, 4), bool))
