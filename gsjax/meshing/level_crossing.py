"""Where a ray first enters the surface: a short march over the density, then a bisection."""

from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from gsjax.meshing import density_field
from gsjax.meshing.density_field import Kernels

HALVINGS = 6  # Of the step that holds the crossing.


@partial(jax.jit, static_argnames="samples")
def march_rays(
    field: Kernels,
    hits: Array,
    directions: Array,
    neighbor_ids: Array,
    *,
    level: float,
    samples: int,
    sigma_range: float,
) -> tuple[Array, Array, Array]:
    """`march_ray` for `[R, 3]` hits and directions with `[R, k]` neighbour ids, the hit Gaussian first."""
    march = partial(march_ray, level=level, samples=samples, sigma_range=sigma_range)
    return jax.vmap(lambda hit, direction, ids: march(density_field.take(field, ids), hit, direction))(
        hits, directions, neighbor_ids
    )


def march_ray(
    nearby: Kernels, hit: Array, direction: Array, *, level: float, samples: int, sigma_range: float
) -> tuple[Array, Array, Array]:
    """The first crossing of the level along one ray, from outside to inside.

    Args:
        nearby: `[k]` kernels that make the density; the first is the hit Gaussian.
        hit: `[3]` world point; the march is centred near it, where the hit Gaussian is densest on the ray.
        direction: `[3]` unit, away from the camera.
        level: Density of the surface.
        samples: Number of evenly spaced densities.
        sigma_range: Half length of the march in standard deviations of the hit Gaussian along the ray.

    Returns:
        Point `[3]`, unit outward normal `[3]`, and whether there is a crossing; without one, the point and the normal
        mean nothing but are finite.
    """
    profile = density_field.along_ray(hit, direction, nearby)

    def density_at(t: Array) -> Array:
        # Overlapping Gaussians add up beyond 1; opacity does not.
        return jnp.minimum(density_field.profile_density(t, profile), 1.0)

    reach = sigma_range * density_field.deviation_along(direction, density_field.take(nearby, 0))
    # A sample on the peak cannot step over a Gaussian that is thinner than the spacing of the samples.
    center = jnp.clip(profile.peaks[0], -reach, reach)
    steps = center + jnp.linspace(-1.0, 1.0, samples, dtype=hit.dtype) * reach
    inside = jax.vmap(density_at)(steps) > level
    first = jnp.argmax(inside)
    crossed = inside[first] & ~inside[0]
    bracket = (steps[jnp.maximum(first - 1, 0)], steps[first])
    point = hit + _crossing(density_at, bracket, level) * direction

    gradient = density_field.density_gradient(point, nearby)
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
