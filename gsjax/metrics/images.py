"""Image metrics as 3D Gaussian Splatting has them: PSNR and SSIM, with an optional mask of valid pixels.

All are jit-able and differentiable, and SSIM is also the D-SSIM of the training loss, which runs in every step. Hence
the form that XLA makes fast on a CPU: the window is two passes of 11 shifted sums, each one vectorised loop, over
images seen as `[H, W C]` (no transposes), and means are products with ones, which no loop is fused into.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

_WINDOW_RADIUS = 5  # 11 taps
_WINDOW_SIGMA = 1.5  # pixels
_C1 = 0.01**2  # for a dynamic range of 1
_C2 = 0.03**2


def psnr(
    image: Float[Array, "H W C"], target: Float[Array, "H W C"], mask: Bool[Array, "H W"] | None = None
) -> Float[Array, ""]:
    """Peak signal-to-noise ratio, `20 log10(1 / sqrt(mse))`, over all valid pixels and channels.

    Args:
        image: Clamped to 0..1 by the caller.
        target: In 0..1.
        mask: The pixels that count; all where None.

    Returns:
        Decibels; infinite for equal images.
    """
    return -10.0 * jnp.log10(mse(image, target, mask))


def in_decibels(mse: Array) -> Array:
    """PSNR of a mean squared error of colours in 0..1, at most 100 dB: what logs hold is finite."""
    return -10 * jnp.log10(jnp.maximum(mse, 1e-10))


def mse(image: Array, target: Array, mask: Array | None = None) -> Array:
    """`[]` mean squared difference over the valid pixels and all channels; 0 where no pixel is valid."""
    image, target = _checked_and_masked(image, target, mask)
    return _mean(jnp.square(image - target), mask)


def ssim(
    image: Float[Array, "H W C"], target: Float[Array, "H W C"], mask: Bool[Array, "H W"] | None = None
) -> Float[Array, ""]:
    """Structural similarity: the mean of `ssim_map` over the valid pixels and all channels.

    Invalid pixels are zero in both images, exactly as what lies beyond the border is.

    Args:
        image: In 0..1.
        target: In 0..1.
        mask: The pixels that count; all where None.

    Returns:
        At most 1, which equal images reach.
    """
    image, target = _checked_and_masked(image, target, mask)
    return _mean(ssim_map(image, target), mask)


def ssim_map(image: Array, target: Array) -> Array:
    """`[H, W, C]` similarity of the neighbourhoods of every pixel, channel by channel.

    Neighbourhoods are weighted by an 11x11 Gaussian window (sigma 1.5 pixels) and read zeros beyond the border
    (Wang et al. 2004, in the variant of 3DGS).
    """
    x, y = (a.reshape(a.shape[0], -1) for a in (image, target))
    channels = image.shape[2]
    # The two variances enter only as their sum, so four blurs do for the usual five.
    moments: list[Array] = [window_means(m, channels) for m in (x, y, x * x + y * y, x * y)]
    mean_x, mean_y, mean_squares, mean_product = moments
    product, squares = mean_x * mean_y, mean_x * mean_x + mean_y * mean_y
    luminance = (2 * product + _C1) / (squares + _C1)
    structure = (2 * (mean_product - product) + _C2) / (mean_squares - squares + _C2)
    return (luminance * structure).reshape(image.shape)


@partial(jax.custom_vjp, nondiff_argnums=(1,))
def window_means(rows: Array, channels: int) -> Array:
    """Means `[H, W C]` in the window about every pixel, channel by channel, zeros beyond the border.

    The operator is symmetric, hence its own transpose. Said so in `defvjp`, the backward pass is as fast as the
    forward; the transpose that autodiff derives (a sum of padded slices) is five times slower.
    """
    return _weighted_shifts(_weighted_shifts(rows, 1, channels), 0, 1)


window_means.defvjp(
    lambda rows, channels: (window_means(rows, channels), None),
    lambda channels, _, cotangent: (window_means(cotangent, channels),),
)


def _weighted_shifts(rows: Array, axis: int, stride: int) -> Array:
    offsets = np.arange(-_WINDOW_RADIUS, _WINDOW_RADIUS + 1)
    weights = np.exp(-0.5 * (offsets / _WINDOW_SIGMA) ** 2)
    weights /= weights.sum()
    size, border = rows.shape[axis], _WINDOW_RADIUS * stride
    padded = jnp.pad(rows, [(border, border) if a == axis else (0, 0) for a in range(2)])
    # Rounding to the precision at hand changes nothing, but XLA does not fuse through it: otherwise it would compute
    # the padded image, and all that leads to it, once for each of the 11 slices.
    precision = jnp.finfo(rows.dtype)
    padded = jax.lax.reduce_precision(padded, precision.nexp, precision.nmant)
    total = jnp.zeros_like(rows)
    for index, weight in enumerate(weights):
        total += float(weight) * jax.lax.slice_in_dim(padded, index * stride, index * stride + size, axis=axis)
    return total


def _mean(values: Array, mask: Array | None) -> Array:
    """Mean over the valid pixels and all channels of `[H, W, C]`; zero where none is valid."""
    if mask is None:
        count = jnp.asarray(values.size, values.dtype)
    else:
        values = jnp.where(mask[..., None], values, jnp.zeros_like(values))
        count = jnp.maximum(jnp.sum(mask) * values.shape[2], 1).astype(values.dtype)
    rows = values.reshape(values.shape[0], -1)
    return jnp.sum(jnp.dot(rows, jnp.ones(rows.shape[1], rows.dtype), precision="highest")) / count


def _checked_and_masked(image: Array, target: Array, mask: Array | None) -> tuple[Array, Array]:
    if image.ndim != 3 or image.shape != target.shape:
        raise ValueError(f"expected two images [H, W, C] of one shape, got {image.shape=} and {target.shape=}")
    if mask is None:
        return image, target
    if mask.shape != image.shape[:2]:
        raise ValueError(f"{mask.shape=} does not match {image.shape=}")
    covered = mask[..., None]
    return jnp.where(covered, image, jnp.zeros_like(image)), jnp.where(covered, target, jnp.zeros_like(target))
