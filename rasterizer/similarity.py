"""Structural similarity (SSIM) of two images, with its gradient: native loops on a CPU, jnp elsewhere.

D-SSIM of the training loss runs in every step. Hence also the form of the jnp code, which XLA makes fast on a CPU: the
window is two passes of 11 shifted sums, each one vectorised loop, over images seen as `[H, W C]` (no transposes), and
means are products with ones, which no loop is fused into.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from rasterizer.engines import Backend, load_loops, native_loops
from rasterizer.tracing import vary_alike

WINDOW_RADIUS = 5  # 11 taps
WINDOW_SIGMA = 1.5  # pixels
_C1 = 0.01**2  # for a dynamic range of 1
_C2 = 0.03**2


def ssim(
    image: Float[Array, "H W C"],
    target: Float[Array, "H W C"],
    mask: Bool[Array, "H W"] | None = None,
    *,
    backend: Backend = "auto",
) -> Float[Array, ""]:
    """The mean of `ssim_map` over the valid pixels and all channels; 0 where no pixel is valid.

    Args:
        image: In 0..1. Invalid pixels are read as zero in both images, as what is beyond the border is.
        target: In 0..1.
        mask: The valid pixels; all where None.
        backend: "native" is the loops of a CPU, for float32 and up to three channels. Static.

    Returns:
        At most 1, which equal images reach. Differentiable to both images, any number of times, in reverse mode.
    """
    loops = native_loops(backend)
    is_single = image.dtype == target.dtype == jnp.float32
    if loops and is_single and 0 < image.shape[2] <= loops.MAX_IMAGE_CHANNELS:
        mask = jnp.ones(image.shape[:2], bool) if mask is None else mask
        total, _ = _compare(*vary_alike((image, target, mask)))
        return total / _count(image, mask)
    return mean_over_pixels(ssim_map(*_masked(image, target, mask)), mask)


def mean_over_pixels(values: Array, mask: Array | None) -> Array:
    """`[]` mean over the valid pixels `[H, W]` and all channels of `[H, W, C]`; 0 where no pixel is valid."""
    if mask is not None:
        values = jnp.where(mask[..., None], values, jnp.zeros_like(values))
    rows = values.reshape(values.shape[0], -1)
    return jnp.sum(jnp.dot(rows, jnp.ones(rows.shape[1], rows.dtype), precision="highest")) / _count(values, mask)


def ssim_map(image: Array, target: Array) -> Array:
    """`[H, W, C]` similarity of the neighbourhoods of every pixel, channel by channel, in jnp.

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
    offsets = np.arange(-WINDOW_RADIUS, WINDOW_RADIUS + 1)
    weights = np.exp(-0.5 * (offsets / WINDOW_SIGMA) ** 2)
    weights /= weights.sum()
    size, border = rows.shape[axis], WINDOW_RADIUS * stride
    padded = jnp.pad(rows, [(border, border) if a == axis else (0, 0) for a in range(2)])
    # Rounding to the precision at hand changes nothing, but XLA does not fuse through it: otherwise it would compute
    # the padded image, and all that leads to it, once for each of the 11 slices.
    precision = jnp.finfo(rows.dtype)
    padded = jax.lax.reduce_precision(padded, precision.nexp, precision.nmant)
    total = jnp.zeros_like(rows)
    for index, weight in enumerate(weights):
        total += float(weight) * jax.lax.slice_in_dim(padded, index * stride, index * stride + size, axis=axis)
    return total


def _count(values: Array, mask: Array | None) -> Array:
    """`[]` numbers of the valid pixels, at least 1."""
    count = values.size if mask is None else jnp.sum(mask) * values.shape[2]
    return jnp.maximum(count, 1).astype(values.dtype)


def _masked(image: Array, target: Array, mask: Array | None) -> tuple[Array, Array]:
    if mask is None:
        return image, target
    valid = mask[..., None]
    return jnp.where(valid, image, jnp.zeros_like(image)), jnp.where(valid, target, jnp.zeros_like(target))


# The loops. Each rule calls the function that it is the rule of, so that a second derivative finds a rule again.


@jax.custom_vjp
def _compare(image: Array, target: Array, mask: Array) -> tuple[Array, Array]:
    """`[]` sum over the valid pixels and all channels, and `[3, H, W, C]` what `_gradient` reads."""
    return load_loops().ssim(image, target, mask)


def _compare_fwd(image: Array, target: Array, mask: Array):
    total, slopes = _compare(image, target, mask)
    return (total, slopes), (image, target, mask, slopes)


def _compare_bwd(residuals, cotangents):
    image, target, mask, slopes = residuals
    cotangent, _ = cotangents
    d_image = _gradient(image, target, mask, slopes, cotangent)
    # SSIM is symmetric. XLA leaves this out where no gradient to the target is used.
    d_target = _gradient(target, image, mask, _compare(target, image, mask)[1], cotangent)
    return d_image, d_target, None


_compare.defvjp(_compare_fwd, _compare_bwd)


@jax.custom_vjp
def _gradient(image: Array, target: Array, mask: Array, slopes: Array, cotangent: Array) -> Array:
    """`[H, W, C]` gradient of `_compare` to the image."""
    return load_loops().call("ssim_gradient", image, image, target, mask, slopes, cotangent)


def _gradient_fwd(image: Array, target: Array, mask: Array, slopes: Array, cotangent: Array):
    return _gradient(image, target, mask, slopes, cotangent), (image, target, mask, cotangent)


def _gradient_bwd(residuals, cotangent_of_gradient: Array):
    """The derivative of the jnp code, which also holds what depends on the images by way of the slopes."""
    image, target, mask, cotangent = residuals

    def total(image, target):
        return jnp.sum(jnp.where(mask[..., None], ssim_map(*_masked(image, target, mask)), 0))

    def gradient(image, target, cotangent):
        return cotangent * jax.grad(total)(image, target)

    d_image, d_target, d_cotangent = jax.vjp(gradient, image, target, cotangent)[1](cotangent_of_gradient)
    return d_image, d_target, None, None, d_cotangent


_gradient.defvjp(_gradient_fwd, _gradient_bwd)
