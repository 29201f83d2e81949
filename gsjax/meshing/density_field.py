"""The density field of the Gaussians near a point (paper, Eq. 1), its gradient, and where a ray enters the surface.

    d(p) = sum_g  alpha_g exp(-1/2 (p - mu_g)^T Sigma_g^-1 (p - mu_g))

Everything is written for one point; callers `vmap`. Value and gradient stay finite for flat, collapsed and huge
Gaussians: a scale counts as at least 1e-8, and a squared Mahalanobis distance as at most 1e8 (SuGaR's guards).
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from gsjax.gaussians import Gaussians, opacities, rotation_matrices

MIN_LOG_SCALE = -18.420680743952367  # log 1e-8
MAX_DISTANCE = 1e4  # standard deviations
TINY = 1e-30  # A squared inverse deviation under this belongs to a Gaussian without bounds.
HALVINGS = 6  # Of the step of a march that holds the crossing.
SAMPLES = 21  # densities evaluated along a ray (SuGaR)
SIGMA_RANGE = 3.0  # half length of the march, standard deviations of the hit Gaussian along the ray (SuGaR)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Kernels:
    """K Gaussians as the density sees them."""

    means: Array  # [K, 3] world positions
    whitening: Array  # [K, 3, 3] diag(1 / scales) R^T: takes an offset to units of standard deviations
    opacities: Array  # [K] in (0, 1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RayProfile:
    """The density along one ray: K Gaussians of one variable, the distance t from the ray's origin."""

    peaks: Array  # [K] t where each kernel is densest, scene units
    inverse_deviations: Array  # [K] 1 / standard deviation of each one's density along the ray
    heights: Array  # [K] density at the peak


@jax.jit
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
    return jnp.sum(contributions(point, nearby))


def contributions(point: Array, nearby: Kernels) -> Array:
    """`[k]` what each of the `nearby` kernels adds to the density at one world `point` `[3]`."""
    return _contributions(_whitened_offsets(point, nearby), nearby)


def density_gradient(point: Array, nearby: Kernels) -> Array:
    """`[3]` gradient of `density` by the point, world axes, per scene unit; it points into the surface.

    Equal to `jax.grad(density)`, and cheaper. Zero where every kernel is farther than 1e4 standard deviations.
    """
    offsets = _whitened_offsets(point, nearby)
    weights = _contributions(offsets, nearby)
    return -jnp.sum(weights[:, None, None] * offsets[:, :, None] * nearby.whitening, axis=(0, 1))


def along_ray(origin: Array, direction: Array, nearby: Kernels) -> RayProfile:
    """The kernels on a ray from a world point in a unit direction, `[3]` each: `density` as a function of t alone."""
    slopes = jnp.sum(nearby.whitening * direction[None, None, :], axis=-1)
    offsets = _whitened_offsets(origin, nearby)
    squared = jnp.sum(slopes * slopes, axis=-1)
    is_flat = squared < TINY
    squared = jnp.where(is_flat, 1.0, squared)
    peaks = jnp.where(is_flat, 0.0, -jnp.sum(slopes * offsets, axis=-1) / squared)
    nearest = offsets + peaks[:, None] * slopes
    return RayProfile(peaks, jnp.where(is_flat, 0.0, jnp.sqrt(squared)), _contributions(nearest, nearby))


def profile_density(t: Array, profile: RayProfile) -> Array:
    """`[]` density at distance `t` `[]` along the ray of a profile; its cost does not know the three dimensions."""
    deviations = jnp.clip((t - profile.peaks) * profile.inverse_deviations, -MAX_DISTANCE, MAX_DISTANCE)
    return jnp.sum(profile.heights * jnp.exp(-0.5 * deviations * deviations))


def deviation_along(direction: Array, kernel: Kernels) -> Array:
    """`[]` standard deviation of one kernel (no leading axis) projected on a unit direction `[3]`, scene units."""
    precisions = jnp.maximum(jnp.sum(kernel.whitening**2, axis=-1), TINY)
    along = jnp.sum(kernel.whitening * direction[None, :], axis=-1) / precisions
    return jnp.sqrt(jnp.sum(along * along))


def _whitened_offsets(point: Array, nearby: Kernels) -> Array:
    """`[k, 3]` offsets from the centres in standard deviations, clipped where the density is zero anyway."""
    offsets = jnp.sum(nearby.whitening * (point[None, :] - nearby.means)[:, None, :], axis=-1)
    return jnp.clip(offsets, -MAX_DISTANCE, MAX_DISTANCE)


def _contributions(offsets: Array, nearby: Kernels) -> Array:
    """`[k]` alpha_g exp(-m^2 / 2)."""
    squared = jnp.minimum(jnp.sum(offsets * offsets, axis=-1), MAX_DISTANCE**2)
    return nearby.opacities * jnp.exp(-0.5 * squared)


@jax.jit
def march_rays(
    field: Kernels, hits: Array, directions: Array, neighbor_ids: Array, level: float
) -> tuple[Array, Array, Array]:
    """`march_ray` for `[R, 3]` hits and directions with `[R, k]` neighbour ids, the hit Gaussian first."""
    march = partial(march_ray, level=level)
    return jax.vmap(lambda hit, direction, ids: march(take(field, ids), hit, direction))(hits, directions, neighbor_ids)


def march_ray(nearby: Kernels, hit: Array, direction: Array, level: float) -> tuple[Array, Array, Array]:
    """The first crossing of the level along one ray, from outside to inside.

    Args:
        nearby: `[k]` kernels that make the density; the first is the hit Gaussian.
        hit: `[3]` world point; the march is centred near it, where the hit Gaussian is densest on the ray.
        direction: `[3]` unit, away from the camera.
        level: Density of the surface.

    Returns:
        Point `[3]`, unit outward normal `[3]`, and whether there is a crossing; without one, the point and the normal
        mean nothing but are finite.
    """
    profile = along_ray(hit, direction, nearby)

    def density_at(t: Array) -> Array:
        # Overlapping Gaussians add up beyond 1; opacity does not.
        return jnp.minimum(profile_density(t, profile), 1.0)

    reach = SIGMA_RANGE * deviation_along(direction, take(nearby, 0))
    # A sample on the peak cannot step over a Gaussian that is thinner than the spacing of the samples.
    center = jnp.clip(profile.peaks[0], -reach, reach)
    steps = center + jnp.linspace(-1.0, 1.0, SAMPLES, dtype=hit.dtype) * reach
    inside = jax.vmap(density_at)(steps) > level
    first = jnp.argmax(inside)
    crossed = inside[first] & ~inside[0]
    bracket = (steps[jnp.maximum(first - 1, 0)], steps[first])
    point = hit + _crossing(density_at, bracket, level) * direction

    gradient = density_gradient(point, nearby)
    length = jnp.sqrt(jnp.sum(gradient * gradient))
    has_normal = length > 0
    normal = -gradient / jnp.where(has_normal, length, 1.0)
    return point, normal, crossed & has_normal


def _crossing(density_at, bracket: tuple[Array, Array], level: float) -> Array:
    """Where the density reaches the level: halve the bracket (outside, inside), then interpolate linearly.

    Interpolation alone overshoots a Gaussian much thinner than the step, and ends behind it with its normal reversed.
    """

    def halve(_, bracket):
        outside, inside = bracket
        middle = 0.5 * (outside + inside)
        is_inside = density_at(middle) > level
        return jnp.where(is_inside, outside, middle), jnp.where(is_inside, middle, inside)

    outside, inside = jax.lax.fori_loop(0, HALVINGS, halve, bracket)
    low, high = density_at(outside), density_at(inside)
    rises = high > low
    share = jnp.where(rises, (level - low) / jnp.where(rises, high - low, 1.0), 0.0)
    return outside + jnp.clip(share, 0.0, 1.0) * (inside - outside)
