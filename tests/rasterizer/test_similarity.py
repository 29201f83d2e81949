"""SSIM and its gradients, as loops and in jnp: compared with the textbook form in float64, and bad numbers."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import correlate1d
from tolerances import assert_close

from rasterizer.similarity import ssim

SHAPE = (40, 80, 3)  # several tiles of the loops
compare = jax.jit(jax.value_and_grad(ssim, argnums=(0, 1)), static_argnames="backend")


def pair(shape, seed=0):
    """Two smooth images that differ, float32, and a mask with a whole part, an empty part and holes."""
    rng = np.random.default_rng(seed)
    target = correlate1d(rng.random(shape), np.full(5, 0.2), axis=0)
    image = np.clip(target + 0.1 * rng.standard_normal(shape), 0, 1)
    mask = rng.random(shape[:2]) > 0.2
    mask[:, shape[1] // 3 : shape[1] // 2] = True
    mask[shape[0] // 2 :, : shape[1] // 3] = False
    return image.astype(np.float32), target.astype(np.float32), mask


def blur(x):
    """Window means in float64, zeros beyond the border."""
    window = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    window /= window.sum()
    return correlate1d(correlate1d(x, window, axis=0, mode="constant"), window, axis=1, mode="constant")


def in_float64(image, target, mask):
    """SSIM with two variances and a covariance, and its gradient by the chain rule through them."""
    valid = mask[..., None].astype(np.float64)
    x, y = image * valid, target * valid
    mx, my = blur(x), blur(y)
    vx, vy, vxy = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
    a, b, c, d = 2 * mx * my + 1e-4, 2 * vxy + 9e-4, mx**2 + my**2 + 1e-4, vx + vy + 9e-4
    weights = valid / max(mask.sum() * image.shape[2], 1)
    of_mean = weights * (2 * my * b / (c * d) - 2 * mx * a * b / (c * c * d))
    of_variance, of_covariance = -weights * a * b / (c * d * d), 2 * weights * a / (c * d)
    gradient = blur(of_mean - 2 * mx * of_variance - my * of_covariance)
    gradient += 2 * x * blur(of_variance) + y * blur(of_covariance)
    return np.sum(weights * (a * b / (c * d))), gradient * valid


@pytest.mark.parametrize(
    ("backend", "shape", "is_masked"),
    [
        ("native", (1, 2, 3), True),  # smaller than the window
        ("native", (32, 64, 3), False),  # as large as a tile
        ("native", (33, 65, 2), True),
        ("native", (70, 140, 1), True),
        ("native", (12, 13, 4), False),  # a channel too many
        ("native", SHAPE, True),
        ("xla", SHAPE, True),
    ],
)
def test_value_and_both_gradients_are_those_in_float64(backend, shape, is_masked):
    image, target, mask = pair(shape)
    mask = mask if is_masked else np.ones_like(mask)
    value, gradients = compare(image, target, mask if is_masked else None, backend=backend)
    expected, to_image = in_float64(image.astype(np.float64), target.astype(np.float64), mask)
    _, to_target = in_float64(target.astype(np.float64), image.astype(np.float64), mask)
    assert_close(value, expected)
    for gradient, right in zip(gradients, (to_image, to_target), strict=True):
        assert_close(
            gradient / max(np.abs(right).max(), 1e-30), right / max(np.abs(right).max(), 1e-30), kind="gradient"
        )
        assert np.all(np.asarray(gradient)[~mask] == 0)


@pytest.mark.parametrize("backend", ["native", "xla"])
def test_no_valid_pixel_gives_zero_and_no_gradient(backend):
    image, target, mask = pair(SHAPE)
    value, gradients = compare(image, target, np.zeros_like(mask), backend=backend)
    assert value == 0 and not np.any(gradients)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_bad_number_spreads_as_in_jnp(bad):
    image, target, mask = pair(SHAPE)
    mask[:] = True
    mask[12:20, 60:70] = False
    image[20, 66] = bad  # valid, next to invalid pixels and near the border of a tile
    image[14, 64] = bad  # invalid
    native, twin = (compare(image, target, mask, backend=each) for each in ("native", "xla"))
    assert not np.isfinite(native[0]) and not np.isfinite(twin[0])
    np.testing.assert_array_equal(np.isfinite(native[1][0]), np.isfinite(twin[1][0]))
    mask[20, 66] = False
    value, gradients = compare(image, target, mask, backend="native")
    assert np.isfinite(value) and np.isfinite(gradients[0]).all()


def test_the_loops_under_vmap_and_twice_differentiated_are_the_jnp_code():
    image, target, mask = map(jnp.asarray, pair((24, 70, 3)))
    images = jnp.stack([image, 0.5 * image])
    weights = np.random.default_rng(1).normal(size=image.shape).astype(np.float32)

    def projected(image, target, backend):
        gradient = jax.grad(partial(ssim, backend=backend))(image, target, mask)
        return jnp.sum(gradient * weights)

    def values(backend):
        once = jax.vmap(jax.value_and_grad(partial(ssim, backend=backend)), (0, None, None))(images, target, mask)
        return once, jax.grad(partial(projected, backend=backend), argnums=(0, 1))(image, target)

    (once, twice), (expected_once, expected_twice) = (jax.jit(partial(values, b))() for b in ("native", "xla"))
    assert_close(once, expected_once, kind="gradient")
    assert_close(twice, expected_twice, kind="gradient")
    assert np.abs(expected_twice[0]).max() > 1e-3


def test_other_dtypes_run_in_jnp(x64):
    image, target, mask = pair((10, 12, 3))
    image, target = image.astype(np.float64), target.astype(np.float64)
    value = jax.jit(partial(ssim, backend="native"))(image, target, mask)
    assert_close(value, in_float64(image, target, mask)[0])
