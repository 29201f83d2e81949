"""The density field of the Gaussians near a point (paper, Eq. 1), and its gradient in closed form.

    d(p) = sum_g  alpha_g exp(-1/2 (p - mu_g)^T Sigma_g^-1 (p - mu_g))

Everything is written for one point; callers `vmap`. Value and gradient stay finite for flat, collapsed and huge
Gaussians: a scale counts as at least 1e-8, and a squared Mahalanobis distance as at most 1e8 (SuGaR's guards).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array

from gsjax.gaussians import Gaussians, opacities, rotation_matrices

MIN_LOG_SCALE = -18.420680743952367  # log 1e-8
MAX_SQUARED_DISTANCE = 1e8


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Kernels:
    """K Gaussians as the density sees them."""

    means: Array  # [K, 3] world positions
    whitening: Array  # [K, 3, 3] diag(1 / scales) R^T: takes an offset to units of standard deviations
    opacities: Array  # [K] in (0, 1)


def kernels(gaussians: Gaussians) -> Kernels:
    """All Gaussians, ready to be indexed by neighbour ids."""
    inverse_scales = jnp.exp(-jnp.maximum(gaussians.log_scales, MIN_LOG_SCALE))
    axes = rotation_matrices(gaussians.quats)
    return Kernels(gaussians.means, inverse_scales[:, :, None] * jnp.swapaxes(axes, 1, 2), opacities(gaussians))


def take(field: Kernels, neighbors: Array) -> Kernels:
    """The kernels that `neighbors` `[k]` (integers) names."""
    return jax.tree.map(lambda x: x[neighbors], field)


def density(point: Array, nearby: Kernels) -> Array:
    """`[]` density at one world `point` `[3]`, summed over the `nearby` kernels; may exceed 1."""
    return jnp.sum(_contributions(_whitened_offsets(point, nearby), nearby))


def density_gradient(point: Array, nearby: Kernels) -> Array:
    """`[3]` gradient of `density` by the point, world axes, per scene unit; it points into the surface.

    Equal to `jax.grad(density)`, and cheaper. Zero where every kernel is farther than 1e4 standard deviations.
    """
    offsets = _whitened_offsets(point, nearby)
    weights = _contributions(offsets, nearby)
    return -jnp.sum(weights[:, None, None] * offsets[:, :, None] * nearby.whitening, axis=(0, 1))


def _whitened_offsets(point: Array, nearby: Kernels) -> Array:
    """`[k, 3]` offsets from the centres in standard deviations, clipped where the density is zero anyway."""
    offsets = jnp.sum(nearby.whitening * (point[None, :] - nearby.means)[:, None, :], axis=-1)
    return jnp.clip(offsets, -(MAX_SQUARED_DISTANCE**0.5), MAX_SQUARED_DISTANCE**0.5)


def _contributions(offsets: Array, nearby: Kernels) -> Array:
    """`[k]` alpha_g exp(-m^2 / 2)."""
    squared = jnp.minimum(jnp.sum(offsets * offsets, axis=-1), MAX_SQUARED_DISTANCE)
    return nearby.opacities * jnp.exp(-0.5 * squared)
