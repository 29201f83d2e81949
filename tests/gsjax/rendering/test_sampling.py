import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from tolerances import assert_close

from gsjax.rendering.sampling import sample_bilinear

IMAGE = np.random.default_rng(0).random((5, 8)).astype(np.float32)


all_sampled = jax.jit(jax.vmap(sample_bilinear, in_axes=(None, 0)))
slopes = jax.jit(jax.grad(sample_bilinear, (0, 1)))


def sampled(pixels, image=IMAGE):
    return all_sampled(jnp.asarray(image), jnp.asarray(pixels, jnp.float32))


def test_values_equal_scipys_inside_and_beyond_the_border():
    pixels = np.random.default_rng(1).uniform([-3, -3], [11, 8], (200, 2))
    expected = map_coordinates(
        IMAGE.astype(np.float64), [pixels[:, 1] - 0.5, pixels[:, 0] - 0.5], order=1, mode="nearest"
    )
    assert_close(sampled(pixels), expected)


def test_slope_is_that_of_the_patch_and_zero_beyond_the_border():
    inside = slopes(jnp.asarray(IMAGE), jnp.asarray([3.0, 2.25], jnp.float32))[1]
    patch = IMAGE[1:3, 2:4].astype(np.float64)
    fx, fy = 0.5, 0.75
    by_x = (1 - fy) * (patch[0, 1] - patch[0, 0]) + fy * (patch[1, 1] - patch[1, 0])
    by_y = (1 - fx) * (patch[1, 0] - patch[0, 0]) + fx * (patch[1, 1] - patch[0, 1])
    assert_close(inside, np.array([by_x, by_y]))
    assert_close(slopes(jnp.asarray(IMAGE), jnp.asarray([-2.0, 9.0], jnp.float32))[1], np.zeros(2))


@pytest.mark.parametrize("pixel", [(3.3, 2.2), (-5.0, 1.7), (1e30, -1e30)])
def test_gradient_to_the_image_is_a_partition_of_unity(pixel):
    weights = slopes(jnp.asarray(IMAGE), jnp.asarray(pixel, jnp.float32))[0]
    assert float(weights.sum()) == pytest.approx(1, abs=1e-6)
    assert float(weights.min()) >= 0
    assert int((weights > 0).sum()) <= 4


@pytest.mark.parametrize("shape", [(1, 4), (3, 1)])
def test_images_of_one_row_or_column(shape):
    image = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    pixels = np.array([[0.5, 0.5], [shape[1] - 0.5, shape[0] - 0.5], [7.0, 7.0]])
    assert_close(sampled(pixels, image), np.array([0, image[-1, -1], image[-1, -1]]))
