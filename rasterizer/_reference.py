"""The oracle: every Gaussian at every pixel, no tiles, no custom rule.

Any float dtype, forward and reverse mode, any order of differentiation. Pixels run in blocks, so that memory is
block x splats; a block is recomputed in the backward pass.
"""

import jax
import jax.numpy as jnp
from jax import Array

from rasterizer.blending import cut_alpha, splat_sigma
from rasterizer.projection import Projection
from rasterizer.rules import Rules

BLOCK = 512  # Pixels per block.


def _blend_pixel(pixel: Array, means2d, conics, opacities, features, rules: Rules) -> tuple[Array, Array, Array]:
    """Features `[D]`, transmittance `[]` and median splat's rank `[]` of one pixel from splats sorted front to back."""
    d = means2d - pixel
    sigma = splat_sigma(d[:, 0], d[:, 1], conics[:, 0], conics[:, 1], conics[:, 2])
    unclamped = opacities * jnp.exp(-jnp.where(sigma >= 0, sigma, 0))
    alpha = cut_alpha(unclamped, sigma, rules)
    if rules.straight_through:
        alpha = jnp.where(alpha > 0, unclamped + jax.lax.stop_gradient(alpha - unclamped), 0)
    left = jnp.concatenate([jnp.ones(1, alpha.dtype), jnp.cumprod(1 - alpha)])
    # Transmittance only falls, so everything from the first stop on is under the limit too.
    live = left[1:] > rules.transmittance_min
    weights = jnp.where(live, left[:-1] * alpha, 0)
    ranks = jnp.arange(weights.shape[0], dtype=jnp.int32)
    median = jnp.max(jnp.where((weights > 0) & (left[:-1] > 0.5), ranks, -1), initial=-1)
    return jnp.sum(weights[:, None] * features, 0), left[jnp.sum(live)], median


def composite(
    projection: Projection, opacities: Array, features: Array, width: int, height: int, rules: Rules
) -> tuple[Array, Array, Array]:
    """Blend all visible splats at all pixels.

    Args:
        projection: Splats of C cameras.
        opacities: `[C, N]`.
        features: `[C, N, D]`.
        width: Image width. Static.
        height: Image height. Static.
        rules: Thresholds. Static.

    Returns:
        `[C, H, W, D]` blended features on nothing, `[C, H, W, 1]` transmittance left, and `[C, H, W]` int32 the splat
        c * N + n in which the light falls to one half (the last one that shows, where it does not; -1 for none).
    """
    dtype = features.dtype
    y, x = jnp.meshgrid(jnp.arange(height, dtype=dtype) + 0.5, jnp.arange(width, dtype=dtype) + 0.5, indexing="ij")
    pixels = jnp.stack([x, y], -1).reshape(-1, 2)
    padding = -pixels.shape[0] % BLOCK
    blocks = jnp.concatenate([pixels, jnp.zeros((padding, 2), dtype)]).reshape(-1, BLOCK, 2)

    def one_camera(means2d, depths, conics, visible, opacity, feature):
        order = jnp.argsort(jnp.where(visible, jax.lax.stop_gradient(depths), jnp.inf)).astype(jnp.int32)
        # Far off the image the square of an offset overflows: every field of a hidden splat is made safe.
        means2d, conics, feature = (jnp.where(visible[:, None], x, 0) for x in (means2d, conics, feature))
        opacity = jnp.where(visible, opacity, 0)
        sorted_splats = means2d[order], conics[order], opacity[order], feature[order]

        @jax.checkpoint
        def block(pixels):
            return jax.vmap(lambda pixel: _blend_pixel(pixel, *sorted_splats, rules))(pixels)

        flat = [x.reshape(-1, *x.shape[2:])[: height * width] for x in jax.lax.map(block, blocks)]
        image, left, median = (x.reshape(height, width, *x.shape[1:]) for x in flat)
        order = jnp.append(order, -1)  # What rank -1 reads.
        return image, left[..., None], order[median]

    p = projection
    num_cameras, num_splats = p.depths.shape
    image, left, median = jax.vmap(one_camera)(p.means2d, p.depths, p.conics, p.visible, opacities, features)
    first = num_splats * jnp.arange(num_cameras, dtype=jnp.int32)[:, None, None]
    return image, left, jnp.where(median >= 0, first + median, -1)
