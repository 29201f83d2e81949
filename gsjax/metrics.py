"""Image measures as 3D Gaussian Splatting scores them: PSNR and SSIM, with an optional mask of valid pixels.

Both are jit-able and differentiable, and SSIM is also the D-SSIM of the training loss. It runs in every step, so the
window is applied as two passes of 11 shifted sums: XLA fuses each into one vectorised loop, several times faster on a
CPU than its convolution or a banded matrix product.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

_WINDOW_RADIUS = 5  # 11 taps
_WINDOW_SIGMA = 1.5  # pixels
_C1 = 0.01**2  # for a dynamic range of 1
_C2 = 0.03**2


def psnr(image: Array, target: Array, mask: Array | None = None) -> Array:
    """Peak signal-to-noise ratio, `20 log10(1 / sqrt(mse))`, over all valid pixels and channels.

    Args:
        image: `[H, W, C]`, clamped to 0..1 by the caller.
        target: `[H, W, C]`, 0..1.
        mask: `[H, W]` bool, the pixels that count; all where None.

    Returns:
        `[]` decibels; infinite for equal images.
    """
    image, target = _checked_and_masked(image, target, mask)
    return -10.0 * jnp.log10(_mean(jnp.square(image - target), mask))


def ssim(image: Array, target: Array, mask: Array | None = None) -> Array:
    """Structural similarity: the mean of `ssim_map` over the valid pixels and all channels.

    Invalid pixels are zero in both images, exactly as what lies beyond the border is.

    Args:
        image: `[H, W, C]`, 0..1.
        target: `[H, W, C]`, 0..1.
        mask: `[H, W]` bool, the pixels that count; all where None.

    Returns:
        `[]`, at most 1, which equal images reach.
    """
    image, target = _checked_and_masked(image, target, mask)
    return _mean(ssim_map(image, target), mask)


def ssim_map(image: Array, target: Array) -> Array:
    """`[H, W, C]` similarity of the neighbourhoods of every pixel, channel by channel.

    Neighbourhoods are weighted by an 11x11 Gaussian window (sigma 1.5 pixels) and read zeros beyond the border
    (Wang et al. 2004, in the variant of 3DGS).
    """
    x, y = (jnp.moveaxis(a, -1, 0) for a in (image, target))  # the window slides over the contiguous axes
    mean_x, mean_y = _blur(x), _blur(y)
    # The two variances enter only as their sum, so four blurs do for the usual five.
    mean_squares, mean_product = _blur(x * x + y * y), _blur(x * y)
    product, squares = mean_x * mean_y, mean_x * mean_x + mean_y * mean_y
    luminance = (2 * product + _C1) / (squares + _C1)
    structure = (2 * (mean_product - product) + _C2) / (mean_squares - squares + _C2)
    return jnp.moveaxis(luminance * structure, 0, -1)


@jax.custom_vjp
def _blur(channels: Array) -> Array:
    """`[C, H, W]` blurred by the window, zeros beyond the border.

    The operator is symmetric, hence its own transpose. Said so in `defvjp`, the backward pass is as fast as the
    forward; the transpose that autodiff derives (a sum of padded slices) is five times slower.
    """
    return _blur_axis(_blur_axis(channels, 2), 1)


_blur.defvjp(lambda channels: (_blur(channels), None), lambda _, cotangent: (_blur(cotangent),))


def _blur_axis(channels: Array, axis: int) -> Array:
    offsets = np.arange(-_WINDOW_RADIUS, _WINDOW_RADIUS + 1)
    weights = np.exp(-0.5 * (offsets / _WINDOW_SIGMA) ** 2)
    weights /= weights.sum()
    size = channels.shape[axis]
    padded = jnp.pad(channels, [(_WINDOW_RADIUS, _WINDOW_RADIUS) if a == axis else (0, 0) for a in range(3)])
    return sum(
        float(weight) * jax.lax.slice_in_dim(padded, start, start + size, axis=axis)
        for start, weight in enumerate(weights)
    )


def _mean(values: Array, mask: Array | None) -> Array:
    if mask is None:
        return jnp.mean(values)
    valid = jnp.broadcast_to(mask[..., None], values.shape)
    total = jnp.sum(jnp.where(valid, values, jnp.zeros_like(values)))
    return total / jnp.maximum(jnp.sum(valid), 1).astype(values.dtype)


def _checked_and_masked(image: Array, target: Array, mask: Array | None) -> tuple[Array, Array]:
    if image.ndim != 3 or image.shape != target.shape:
        raise ValueError(f"expected two images [H, W, C] of one shape, got {image.shape=} and {target.shape=}")
    if mask is None:
        return image, target
    if mask.shape != image.shape[:2]:
        raise ValueError(f"{mask.shape=} does not match {image.shape=}")
    return tuple(jnp.where(mask[..., None], x, jnp.zeros_like(x)) for x in (image, target))
