"""The oracle: every Gaussian at every pixel, no tiles, no custom rule.

Any float dtype, forward and reverse mode, any order of differentiation. Pixels run in blocks, so that memory is
block x splats; a block is recomputed in the backward pass.
"""

import jax
import jax.numpy as jnp
from jax import Array

from rasterizer.blending import blend_splat, cut_alpha, front_weight, splat_sigma
from rasterizer.compositing import Front
from rasterizer.ewa import Projection
from rasterizer.rules import Rules
from rasterizer.tracing import vary_alike, vary_like

BLOCK = 512  # Pixels per block: the history of a block of 10,000 splats stays under 100 MB.


def _blend_block(pixels: Array, splats: tuple, rules: Rules, front: Front | None) -> tuple[Array, Array, Array]:
    """Features `[B, D]`, transmittance `[B]` and rank of the median splat `[B]` from splats sorted front to back.

    `splats`: means2d, conics, opacities, features, and slopes or None.
    """
    features = splats[3]

    @jax.checkpoint  # Or every step would keep a dozen numbers per pixel for the way back.
    def step(state, splat):
        signed_t, image, median = state
        rank, mean2d, conic, opacity, feature, slope = splat
        dx, dy = mean2d[0] - pixels[:, 0], mean2d[1] - pixels[:, 1]
        sigma = splat_sigma(dx, dy, conic[0], conic[1], conic[2])
        unclamped = opacity * jnp.exp(-jnp.where(sigma >= 0, sigma, 0))
        alpha = cut_alpha(unclamped, sigma, rules)
        if rules.straight_through:
            alpha = jnp.where(alpha > 0, unclamped + jax.lax.stop_gradient(alpha - unclamped), 0)
        weight, left = blend_splat(signed_t, alpha, rules)
        median = jnp.where((weight > 0) & (signed_t > 0.5), rank, median)
        weights = jnp.broadcast_to(weight[:, None], (*weight.shape, *feature.shape))
        if front:
            weights = weights.at[:, -front.channels :].set(front_weight(signed_t, weight, front.stop_after)[:, None])
        contribution = weights * feature[None]
        if slope is not None:
            # Depth, the last feature, is that of the splat's plane at every pixel.
            contribution = contribution.at[:, -1].add(-weights[:, -1] * (slope[0] * dx + slope[1] * dy))
        return (left, image + contribution, median), None

    count, dtype = pixels.shape[0], features.dtype
    start = jnp.ones(count, dtype), jnp.zeros((count, features.shape[1]), dtype), jnp.full(count, -1, jnp.int32)
    ranks, start = jnp.arange(features.shape[0], dtype=jnp.int32), vary_like(start, splats)
    (signed_t, image, median), _ = jax.lax.scan(step, start, (ranks, *splats))
    return image, jnp.abs(signed_t), median


def composite(
    projection: Projection,
    opacities: Array,
    features: Array,
    width: int,
    height: int,
    rules: Rules,
    front: Front | None = None,
) -> tuple[Array, Array, Array]:
    """Blend all visible splats of C cameras at all pixels.

    Opacities are `[C, N]`, features `[C, N, D]`; where the projection has slopes, the last one is the centres' depth.

    Returns:
        `[C, H, W, D]` blended features on nothing, `[C, H, W, 1]` transmittance left, and `[C, H, W]` int32 the splat
        c * N + n in which the light falls to one half (the last one that shows, where it does not; -1 for none).
    """
    projection, opacities, features = vary_alike((projection, opacities, features))
    dtype = features.dtype
    y, x = jnp.meshgrid(jnp.arange(height, dtype=dtype) + 0.5, jnp.arange(width, dtype=dtype) + 0.5, indexing="ij")
    pixels = jnp.stack([x, y], -1).reshape(-1, 2)
    size = min(BLOCK, pixels.shape[0])
    padding = -pixels.shape[0] % size
    blocks = jnp.concatenate([pixels, jnp.zeros((padding, 2), dtype)]).reshape(-1, size, 2)

    def one_camera(means2d, depths, conics, slopes, visible, opacity, feature):
        order = jnp.argsort(jnp.where(visible, jax.lax.stop_gradient(depths), jnp.inf)).astype(jnp.int32)
        # Far off the image the square of an offset overflows: every field of a hidden splat is made safe.
        means2d, conics, feature, slopes = jax.tree.map(
            lambda x: jnp.where(visible[:, None], x, 0), (means2d, conics, feature, slopes)
        )
        opacity = jnp.where(visible, opacity, 0)
        sorted_splats = jax.tree.map(lambda x: x[order], (means2d, conics, opacity, feature, slopes))

        @jax.checkpoint
        def block(pixels):
            return _blend_block(pixels, sorted_splats, rules, front)

        flat = [x.reshape(-1, *x.shape[2:])[: height * width] for x in jax.lax.map(block, blocks)]
        image, left, median = (x.reshape(height, width, *x.shape[1:]) for x in flat)
        order = jnp.append(order, -1)  # What rank -1 reads.
        return image, left[..., None], order[median]

    p = projection
    num_cameras, num_splats = p.depths.shape
    image, left, median = jax.vmap(one_camera)(p.means2d, p.depths, p.conics, p.slopes, p.visible, opacities, features)
    first = num_splats * jnp.arange(num_cameras, dtype=jnp.int32)[:, None, None]
    return image, left, jnp.where(median >= 0, first + median, -1)
