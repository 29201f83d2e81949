"""Points on the level set of the density, found along camera rays.

Every view contributes: random opaque pixels, a short march along their rays around the rendered depth, the first
crossing of the level from outside to inside, and the outward normal there (SuGaR's sampling, with its half-pixel
offset and its inward normals put right).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial import KDTree

from gsjax import cameras as cams
from gsjax import density_field
from gsjax import gaussians as gs
from gsjax.cameras import Camera
from gsjax.density_field import Kernels
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians

MIN_ALPHA = 0.5  # A pixel less opaque than this shows no surface of ours.
HALVINGS = 6  # Of the step that holds the crossing.


@dataclass(frozen=True)
class SurfacePoints:
    """P oriented, coloured points on the level set, and how many rays it took to find them."""

    points: np.ndarray  # [P, 3] float32 world
    normals: np.ndarray  # [P, 3] float32 unit, world, outward: towards the camera that saw the point
    colors: np.ndarray  # [P, 3] uint8 sRGB
    view_ids: np.ndarray  # [P] int32 index of the camera
    rays: int  # marched
    crossings: int  # rays that crossed the level; a random part of them is kept where there are more than asked for
    flipped: int  # of the crossings, those whose density gradient faced away from the camera
    kernels: int  # Gaussians that made the density, after the cull by opacity

    @property
    def crossing_share(self) -> float:
        """Share of rays that met the level; under 0.2 the Gaussians are too soft or too thin for it."""
        return self.crossings / self.rays


@dataclass(frozen=True)
class Rays:
    """R rays to march, numpy, world frame."""

    hits: np.ndarray  # [R, 3] float32 the pixel's point at the rendered depth
    directions: np.ndarray  # [R, 3] float32 unit, away from the camera
    colors: np.ndarray  # [R, 3] uint8
    view_ids: np.ndarray  # [R] int32


def surface_points(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    depths: Sequence[np.ndarray],
    alphas: Sequence[np.ndarray],
    colors: Sequence[np.ndarray],
    *,
    level: float = 0.3,
    num_points: int = 300_000,
    neighbors: int = 16,
    samples: int = 21,
    sigma_range: float = 3.0,
    min_opacity: float = 0.5,
    seed: int = 0,
    chunk: int = 16_384,
) -> SurfacePoints:
    """Points of the level set {d = level} seen by the cameras.

    Args:
        gaussians: The trained scene.
        cameras: One camera a view.
        depths: One `[H, W]` map a view, expected depth (camera z, scene units).
        alphas: One `[H, W]` map a view, accumulated opacity; pixels up to 0.5 are left out.
        colors: One `[H, W, 3]` image a view in 0..1, best rendered from the degree-0 coefficients alone.
        level: Density of the surface; SuGaR takes 0.1, 0.3 or 0.5.
        num_points: Most points returned. 300,000 suit photos of half a megapixel and less; SuGaR takes 10 million.
        neighbors: Gaussians that make the density around a ray: the nearest to its hit and that one's neighbours.
        samples: Densities evaluated along a ray.
        sigma_range: Half length of the march, in standard deviations of the hit Gaussian along the ray.
        min_opacity: Gaussians up to this opacity are left out, unless fewer than `neighbors` would remain.
        seed: Of the random choice of pixels.
        chunk: Rays marched at once; a memory bound, results do not depend on it.

    Returns:
        At most `num_points` points with outward normals.

    Raises:
        InputError: No pixel is opaque, no Gaussian is there, or no ray crosses the level.
    """
    rng = np.random.default_rng(seed)
    kept = _opaque_enough(gaussians, min_opacity, neighbors)
    rays = _draw_rays(cameras, depths, alphas, colors, 2 * (num_points // max(len(cameras), 1) + 1), rng)
    table, nearest = _neighbor_ids(np.asarray(kept.means), rays.hits, neighbors)

    march = partial(march_rays, density_field.kernels(kept), level=level, samples=samples, sigma_range=sigma_range)
    points, normals, crossed = _in_chunks(march, chunk, rays.hits, rays.directions, table[nearest])

    ids = np.flatnonzero(crossed)
    if not len(ids):
        raise InputError(
            f"the level set is empty: none of {len(crossed)} rays crosses density {level} "
            f"({kept.num_gaussians} of {gaussians.num_gaussians} Gaussians kept); train longer or lower the level"
        )
    away = np.sum(normals * rays.directions, axis=-1) > 0
    normals = np.where(away[:, None], -normals, normals)
    chosen = np.sort(rng.choice(ids, min(num_points, len(ids)), replace=False))
    return SurfacePoints(
        points=points[chosen],
        normals=normals[chosen],
        colors=rays.colors[chosen],
        view_ids=rays.view_ids[chosen],
        rays=len(crossed),
        crossings=len(ids),
        flipped=int(away[ids].sum()),
        kernels=kept.num_gaussians,
    )


def _opaque_enough(gaussians: Gaussians, min_opacity: float, neighbors: int) -> Gaussians:
    """The Gaussians above the opacity and with finite parameters, or all finite ones where too few are above it."""
    parameters = (gaussians.means, gaussians.quats, gaussians.log_scales, gaussians.logit_opacities[:, None])
    finite = np.all([np.isfinite(np.asarray(values)).all(axis=1) for values in parameters], axis=0)
    opaque = finite & (np.asarray(gs.opacities(gaussians)) > min_opacity)
    kept = np.flatnonzero(opaque if opaque.sum() >= neighbors else finite)
    if not len(kept):
        raise InputError(f"no surface to extract: none of {gaussians.num_gaussians} Gaussians is usable")
    return gs.take(gaussians, kept)


def _draw_rays(cameras, depths, alphas, colors, rays_per_view: int, rng: np.random.Generator) -> Rays:
    """Random opaque pixels of every view, no pixel twice, back-projected at their centres."""
    views = [
        _rays_of_view(index, camera, np.asarray(depth), np.asarray(alpha), np.asarray(color), rays_per_view, rng)
        for index, (camera, depth, alpha, color) in enumerate(zip(cameras, depths, alphas, colors, strict=True))
    ]
    rays = [np.concatenate(parts) for parts in zip(*views, strict=True)] if views else [np.zeros((0, 3))]
    if not len(rays[0]):
        raise InputError(f"no surface to extract: no pixel of {len(views)} views has alpha > {MIN_ALPHA} and a depth")
    return Rays(*rays)


def _rays_of_view(index, camera: Camera, depth, alpha, color, count: int, rng: np.random.Generator):
    """Arrays (hits, directions, colours, view ids) of one view."""
    size = (camera.height, camera.width)
    if depth.shape != size or alpha.shape != size or color.shape != (*size, 3):
        raise ValueError(f"view {index}: {depth.shape=}, {alpha.shape=}, {color.shape=} do not fit camera {size}")
    rows, cols = np.nonzero((alpha > MIN_ALPHA) & (depth > 0) & np.isfinite(depth))
    drawn = rng.permutation(len(rows))[:count]
    rows, cols = rows[drawn], cols[drawn]

    viewmat = np.asarray(camera.viewmat, np.float64)
    from_camera = np.asarray(cams.pixel_rays(camera), np.float64)[rows, cols] @ viewmat[:3, :3]
    hits = from_camera * depth[rows, cols, None] - viewmat[:3, 3] @ viewmat[:3, :3]
    directions = from_camera / np.linalg.norm(from_camera, axis=-1, keepdims=True)
    bytes_ = np.clip(np.round(color[rows, cols] * 255.0), 0, 255).astype(np.uint8)
    return hits.astype(np.float32), directions.astype(np.float32), bytes_, np.full(len(rows), index, np.int32)


def _neighbor_ids(means: np.ndarray, hits: np.ndarray, neighbors: int) -> tuple[np.ndarray, np.ndarray]:
    """`[N, k]` ids of every Gaussian's nearest (itself first), and `[R]` the Gaussian nearest to each hit."""
    tree = KDTree(means)
    count = min(neighbors, len(means))
    table = np.asarray(tree.query(means, count, workers=-1)[1]).reshape(len(means), count).astype(np.int32)
    # Coincident Gaussians may push one out of its own list, or out of first place.
    own = np.arange(len(means), dtype=np.int32)
    place = np.where((table == own[:, None]).any(1), (table == own[:, None]).argmax(1), count - 1)
    table[own, place] = table[:, 0]
    table[:, 0] = own
    return table, np.asarray(tree.query(hits, 1, workers=-1)[1])


def _in_chunks(march, chunk: int, *arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    """`march` over the leading axis in equal chunks, the last one padded, so that it compiles once."""
    total = len(arrays[0])
    outputs = []
    for start in range(0, total, chunk):
        ids = np.minimum(np.arange(start, start + chunk), total - 1)
        outputs.append(jax.device_get(march(*(array[ids] for array in arrays))))
    return tuple(np.concatenate(parts)[:total] for parts in zip(*outputs, strict=True))


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
        hit: `[3]` world point; the march is centred beside it, where the hit Gaussian is densest on the ray.
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
