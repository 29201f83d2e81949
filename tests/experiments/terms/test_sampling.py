import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import minimum_filter
from terms.sampling import sample_bicubic, sample_central, shrunk
from tolerances import assert_close

IMAGE = np.random.default_rng(0).random((5, 8)).astype(np.float32)


SMOOTH = (sample_central, sample_bicubic)
Y, X = np.indices((9, 11)) + 0.5


def quadratic(x, y):
    return 0.3 + 0.2 * x - 0.5 * y + 0.03 * x * x - 0.04 * x * y + 0.02 * y * y


@jax.jit
def smooth(image, pixels):
    """For both: values `[2, P]`, slopes `[2, P, 2]`, and gradients of both to the map, summed over the pixels."""

    def values(image, pixels):
        return jnp.stack([jax.vmap(sample, (None, 0))(image, pixels) for sample in SMOOTH])

    def slopes(image, pixels):
        return jnp.stack([jax.vmap(jax.grad(sample, 1), (None, 0))(image, pixels) for sample in SMOOTH])

    def dotted(image, pixels):
        return jnp.sum(slopes(image, pixels) * jnp.asarray([1.0, 0.3]).astype(image.dtype))

    return values(image, pixels), slopes(image, pixels), jax.value_and_grad(dotted, (0, 1))(image, pixels)


def test_the_slopes_of_a_quadratic_are_exact(x64):
    pixels = np.random.default_rng(0).uniform(2, 7, (40, 2))
    x, y = pixels.T
    values, slopes, _ = smooth(jnp.asarray(quadratic(X, Y)), jnp.asarray(pixels))
    for found in slopes:
        assert_close(found, np.stack([0.2 + 0.06 * x - 0.04 * y, -0.5 - 0.04 * x + 0.04 * y], -1))
    assert_close(values[1], quadratic(x, y))


def test_at_a_pixel_the_value_is_the_pixel_and_the_slope_its_central_difference(x64):
    image = np.random.default_rng(3).random((9, 11))
    row, column = (index.ravel() for index in np.indices((7, 9)) + 1)
    at = np.stack([column, row], -1) + 0.5
    pixels = np.concatenate([at[:39], at[-1:]])
    row, column = pixels[:, 1].astype(int), pixels[:, 0].astype(int)
    values, slopes, _ = smooth(jnp.asarray(image), jnp.asarray(pixels))
    by_x = 0.5 * (image[row, column + 1] - image[row, column - 1])
    by_y = 0.5 * (image[row + 1, column] - image[row - 1, column])
    for value, slope in zip(values, slopes, strict=True):
        assert_close(value, image[row, column])
        assert_close(slope, np.stack([by_x, by_y], -1))


def test_slopes_are_differentiable_to_the_map_and_the_place(x64):
    rng = np.random.default_rng(4)
    image, pixels = rng.random((9, 11)), rng.uniform(-1, 12, (40, 2))
    image_step, pixel_step = 1e-6 * rng.normal(size=image.shape), 1e-6 * rng.normal(size=pixels.shape)

    def moved(sign):
        return smooth(jnp.asarray(image + sign * image_step), jnp.asarray(pixels + sign * pixel_step))[2]

    to_image, to_pixels = moved(0)[1]
    expected = float(np.sum(to_image * image_step) + np.sum(to_pixels * pixel_step))
    assert 0.5 * float(moved(1)[0] - moved(-1)[0]) == pytest.approx(expected, rel=1e-5)


def test_smooth_reads_beyond_the_border_are_those_of_the_border_and_finite(x64):
    image = np.random.default_rng(5).random((9, 11))
    away = np.array([[-5.0, 1.7], [1e30, -1e30], [0.0, 0.0], [14.0, 4.5]])
    values, slopes, every = smooth(jnp.asarray(image), jnp.asarray(np.tile(away, (10, 1))))
    for value, slope in zip(values, slopes, strict=True):
        assert_close(value[np.array([1, 2])], image[[0, 0], [10, 0]])
        assert_close(slope[1], np.zeros(2))
        assert slope[0, 0] == slope[3, 0] == 0
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(every))


def test_a_shrunk_mask_is_the_minimum_of_its_neighbourhood():
    mask = np.random.default_rng(2).random((9, 12)) > 0.1
    expected = minimum_filter(mask, 3, mode="constant", cval=0)
    assert 5 < expected.sum() < 90
    np.testing.assert_array_equal(jax.jit(shrunk)(mask), expected)
