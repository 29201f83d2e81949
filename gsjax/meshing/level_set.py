"""Points on the level set of the density, found along camera rays.

Every view contributes: random opaque pixels, a short march along their rays around the rendered depth, the first
crossing of the level from outside to inside, and the outward normal there (SuGaR's sampling, with its half-pixel
offset and its inward normals put right).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from tqdm import tqdm

from gsjax import gaussians as gs
from gsjax.errors import InputError, NoSurfaceError
from gsjax.gaussians import Gaussians
from gsjax.meshing import density_field
from gsjax.meshing.mesh_method import Method, SurfaceSamples, typical_scale
from gsjax.meshing.neighborhood import Neighborhood
from gsjax.meshing.poisson import Trim, reconstruct
from gsjax.meshing.regions import Region
from gsjax.rendering.gallery import Picture
from gsjax.scene import cameras as cams
from gsjax.scene.cameras import Camera
from gsjax.scene.colors import to_bytes
from gsjax.scene.meshes import Mesh

PIXELS_PER_POINT = 8  # Photos of so many pixels in all bear one surface point.
FEWEST_POINTS = 200_000
RIM = 0.05  # Of the region's, or its inner box's, longest side: points that far outside shape the surface inside.
QUIET = 3.0  # Seconds of marching that need no bar.
# SuGaR's numbers.
LEVEL = 0.3  # density of the surface, or 0.1 or 0.5
MOST_POINTS = 10_000_000
OVERSAMPLING = 2.0  # rays marched per point wanted; what finds too many is cut back at random
NEIGHBORS = 16  # Gaussians that make the density around a ray, the one that was hit among them
MIN_OPACITY = 0.5  # Gaussians up to this make no density, unless fewer than `NEIGHBORS` would remain
MIN_ALPHA = 0.5  # a pixel covered less shows no surface
CHUNK = 16_384  # rays marched at once: a bound of the memory, results do not depend on it


def points_for(cameras: Sequence[Camera]) -> int:
    """As many points as the photos bear: an eighth of their pixels, 200,000 to 10 million."""
    pixels = sum(camera.width * camera.height for camera in cameras)
    return int(np.clip(pixels // PIXELS_PER_POINT, FEWEST_POINTS, MOST_POINTS))


class SurfacePoints(NamedTuple):
    """P oriented, coloured points on the level set."""

    points: np.ndarray  # [P, 3] float32 world
    normals: np.ndarray  # [P, 3] float32 unit, world, outward: towards the camera that saw the point
    colors: np.ndarray  # [P, 3] uint8 sRGB
    # `kernels`: Gaussians that made the density, after the cull by opacity; `rays`: marched; `crossing_share`: of the
    # rays, those that crossed the level, under 0.2 where Gaussians are too soft or too thin for it; `flipped_share`: of
    # the crossings, those whose density gradient faced away from the camera; `points`: a random part of the crossings.
    report: dict


@dataclass(frozen=True)
class Rays:
    """R rays to march, numpy, world frame."""

    hits: np.ndarray  # [R, 3] float32 the pixel's point at the rendered depth
    directions: np.ndarray  # [R, 3] float32 unit, away from the camera
    colors: np.ndarray  # [R, 3] uint8
    owners: np.ndarray  # [R] int32 the Gaussian that was hit, of those that make the density


def surface_points(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    pictures: Iterable[Picture],
    *,
    level: float = LEVEL,
    most: int | None = None,
) -> SurfacePoints:
    """At most so many points of the level set {d = level} seen by the cameras, with outward normals.

    The pictures, one a camera in order, are of these Gaussians, with owners; they are read one by one. Colours best
    come from the degree-0 coefficients alone. Pixels that a Gaussian too faint to make density owns say nothing. By
    default there are as many points as `points_for` these cameras.

    Raises:
        InputError: A picture has no owners, no pixel is opaque, no Gaussian is there, or no ray crosses the level.
    """
    most = points_for(cameras) if most is None else most
    rng = np.random.default_rng(0)
    ids = opaque_ids(gaussians)
    per_view = most // max(len(cameras), 1) + 1
    place = np.full(gaussians.num_gaussians + 1, -1, np.int32)  # Of each Gaussian among the opaque ones; -1 stays -1.
    place[ids] = np.arange(len(ids))
    rays = _draw_rays(cameras, pictures, place, round(OVERSAMPLING * per_view), rng)

    opaque = gs.take(gaussians, ids)
    points, normals, crossed = _march(opaque, rays, level)
    ids = np.flatnonzero(crossed)
    if not len(ids):
        raise NoSurfaceError(
            f"the level set is empty: none of {len(crossed)} rays crosses density {level} "
            f"({opaque.num_gaussians} of {gaussians.num_gaussians} Gaussians kept); train longer or lower the level"
        )
    # Density grows inwards, so that its gradient is turned about; and a surface that a camera sees faces that camera.
    away = np.sum(normals * rays.directions, axis=-1) > 0
    normals[away] *= -1
    sample = np.sort(rng.choice(ids, min(most, len(ids)), replace=False))
    report = {
        "kernels": opaque.num_gaussians,
        "rays": len(crossed),
        "crossing_share": len(ids) / len(crossed),
        "flipped_share": int(away[ids].sum()) / len(ids),
        "points": len(sample),
    }
    return SurfacePoints(points[sample], normals[sample], rays.colors[sample], report)


def opaque_ids(gaussians: Gaussians) -> np.ndarray:
    """`[K]` of the finite Gaussians above `MIN_OPACITY`, or of all finite ones, were it under `NEIGHBORS`.

    Raises:
        InputError: No Gaussian is finite.
    """
    parameters = (gaussians.means, gaussians.quats, gaussians.log_scales, gaussians.logit_opacities[:, None])
    finite = np.all([np.isfinite(np.asarray(values)).all(axis=1) for values in parameters], axis=0)
    opaque = finite & (np.asarray(gs.opacities(gaussians)) > MIN_OPACITY)
    ids = np.flatnonzero(opaque if opaque.sum() >= NEIGHBORS else finite)
    if not len(ids):
        raise NoSurfaceError(f"no surface to extract: none of {gaussians.num_gaussians} Gaussians is usable")
    return ids


def world_points(camera: Camera, depth: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> tuple:
    """`[R, 3]` world points of pixels of a `[H, W]` depth map, and `[R, 3]` unit rays away from the camera."""
    viewmat = np.asarray(camera.viewmat, np.float64)
    rays = np.asarray(cams.pixel_rays(camera), np.float64)[rows, columns] @ viewmat[:3, :3]
    points = rays * depth[rows, columns, None] - viewmat[:3, 3] @ viewmat[:3, :3]
    return points, rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def check_sizes(index: int, camera: Camera, picture: Picture) -> None:
    """Raise ValueError where a picture is not as large as its camera's image."""
    size = (camera.height, camera.width)
    shapes = {name: part.shape for name, part in picture._asdict().items() if part is not None}
    if any(shape[:2] != size for shape in shapes.values()):
        sizes = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise ValueError(f"view {index}: {sizes} do not fit camera {size}")


def shows_surface(picture: Picture) -> np.ndarray:
    """`[H, W]` bool: covered by more than `MIN_ALPHA`, with a depth."""
    depth = np.asarray(picture.depth)
    return (np.asarray(picture.alphas) > MIN_ALPHA) & (depth > 0) & np.isfinite(depth)


def _draw_rays(cameras, pictures, place: np.ndarray, rays_per_view: int, rng: np.random.Generator) -> Rays:
    """Random opaque pixels of every view, no pixel twice, back-projected at their centres."""
    views = []
    for index, (camera, picture) in enumerate(zip(cameras, pictures, strict=True)):
        check_sizes(index, camera, picture)
        if picture.owners is None:
            hint = "draw pictures with gallery.pictures(..., with_owners=True), or leave them out"
            raise InputError(f"view {index}: its picture does not say which Gaussian each pixel hit; {hint}")
        depth, owners = np.asarray(picture.depth), place[picture.owners]
        rows, columns = np.nonzero(shows_surface(picture) & (owners >= 0))
        sample = rng.permutation(len(rows))[:rays_per_view]
        rows, columns = rows[sample], columns[sample]
        hits, directions = world_points(camera, depth, rows, columns)
        colors = to_bytes(np.asarray(picture.colors)[rows, columns])
        views.append((hits.astype(np.float32), directions.astype(np.float32), colors, owners[rows, columns]))
    rays = [np.concatenate(parts) for parts in zip(*views, strict=True)] if views else [np.zeros((0, 3))]
    if not len(rays[0]):
        raise NoSurfaceError(
            f"no surface to extract: no pixel of {len(views)} views has alpha > {MIN_ALPHA}, a depth,"
            " and an owner that is opaque"
        )
    return Rays(*rays)


def _march(gaussians: Gaussians, rays: Rays, level: float) -> tuple[np.ndarray, ...]:
    """Points, outward normals and whether there is a crossing, of every ray, chunk by chunk."""
    nearby = Neighborhood(gaussians, NEIGHBORS)
    field = density_field.kernels(gaussians)
    total = len(rays.hits)
    crossings = np.empty((total, 3), np.float32), np.empty((total, 3), np.float32), np.empty(total, bool)
    for start in tqdm(range(0, total, CHUNK), desc="level set", unit="chunk", delay=QUIET):
        # The last chunk is padded with repetitions, so that all have one length and one compilation.
        ids = np.minimum(np.arange(start, start + CHUNK), total - 1)
        around = nearby.of(rays.hits[ids], rays.owners[ids])
        part = jax.device_get(density_field.march_rays(field, rays.hits[ids], rays.directions[ids], around, level))
        for whole, values in zip(crossings, part, strict=True):
            whole[start : start + CHUNK] = values[: total - start]
    return crossings


def level_set_poisson(
    *, level: float = LEVEL, most: int | None = None, depth: int | None = None, trim: Trim | None = None
) -> Method:
    """Return the method: `surface_points` of the level, at most so many, and `poisson.reconstruct` through them.

    Its pictures need owners.
    """

    def from_level_set(gaussians: Gaussians, cameras: Sequence[Camera], pictures: Iterable[Picture]) -> SurfaceSamples:
        points, normals, colors, report = surface_points(gaussians, cameras, pictures, level=level, most=most)

        def build(region: Region) -> tuple[Mesh, dict]:
            near = region.grown(RIM * (region.without or region.box).longest).contains(points)
            cell = typical_scale(gaussians, region)
            return reconstruct(points[near], normals[near], colors[near], depth=depth, trim=trim, smallest_cell=cell)

        return SurfaceSamples(points, build, report)

    return from_level_set
