"""Image metrics as 3D Gaussian Splatting has them: PSNR and SSIM, with an optional mask of valid pixels.

All are jit-able and differentiable.
"""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from rasterizer import similarity
from rasterizer.similarity import mean_over_pixels


def psnr(
    image: Float[Array, "H W C"], target: Float[Array, "H W C"], mask: Bool[Array, "H W"] | None = None
) -> Float[Array, ""]:
    """Peak signal-to-noise ratio, `20 log10(1 / sqrt(mse))`, over all valid pixels and channels.

    In decibels; infinite for equal images. Both are in 0..1.
    """
    return -10.0 * jnp.log10(mse(image, target, mask))


def in_decibels(mse: Array) -> Array:
    """PSNR of a mean squared error of colours in 0..1, at most 100 dB: what logs hold is finite."""
    return -10 * jnp.log10(jnp.maximum(mse, 1e-10))


def mse(image: Array, target: Array, mask: Array | None = None) -> Array:
    """`[]` mean squared difference over the valid pixels and all channels; 0 where no pixel is valid."""
    _check(image, target, mask)
    difference = image - target if mask is None else jnp.where(mask[..., None], image - target, 0)
    return mean_over_pixels(jnp.square(difference), mask)


def ssim(
    image: Float[Array, "H W C"], target: Float[Array, "H W C"], mask: Bool[Array, "H W"] | None = None
) -> Float[Array, ""]:
    """Structural similarity: its mean over the valid pixels and all channels, see `rasterizer.similarity.ssim_map`.

    Invalid pixels are zero in both images, exactly as what is beyond the border is. On a CPU float32 images are
    compared in native loops. Images are in 0..1; equal ones have 1, the most.
    """
    _check(image, target, mask)
    return similarity.ssim(image, target, mask)


def _check(image: Array, target: Array, mask: Array | None) -> None:
    if image.ndim != 3 or image.shape != target.shape:
        raise ValueError(f"expected two images [H, W, C] of one shape, got {image.shape=} and {target.shape=}")
    if mask is not None and mask.shape != image.shape[:2]:
        raise ValueError(f"{mask.shape=} does not match {image.shape=}")
