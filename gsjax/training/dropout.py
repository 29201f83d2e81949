"""Dropout of Gaussians: each step leaves some out at random, so that training on few photos overfits less."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jax import Array

from gsjax.gaussians import DEAD_LOGIT, Gaussians, opacities

MOST = 0.999  # of a denser one's opacity


def leave_out(gaussians: Gaussians, share: float, key: Array) -> Gaussians:
    """The Gaussians that a step draws: some are left out, and the others are more opaque in return.

    Each is left out with a probability of `share`. The others have 1 / (1 - share) times their opacity, so that the
    expectation of every opacity stays, as far as it is below 1 - share: what is more opaque has no gradient to its
    opacity, and does not become more so. After DropGaussian (Park, Ryu and Kim, CVPR 2025), whose share grows.

    Differentiable. Rows that are left out are drawn as little as free rows are, without gradient.
    """
    stays = jax.random.uniform(key, (gaussians.num_gaussians,), jnp.float32) >= share
    safe = replace(gaussians, logit_opacities=jnp.maximum(gaussians.logit_opacities, DEAD_LOGIT))
    denser = jnp.minimum(opacities(safe) / (1 - share), MOST)
    logits = jnp.log(denser) - jnp.log1p(-denser)
    return replace(gaussians, logit_opacities=jnp.where(stays, logits, DEAD_LOGIT))
