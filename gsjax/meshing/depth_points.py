"""Poisson through the rendered depth: what the splats of a pixel show together is smoother than their density."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from gsjax.errors import NoSurfaceError
from gsjax.gaussians import Gaussians
from gsjax.meshing import level_set
from gsjax.meshing.mesh_method import Method, SurfaceSamples, poisson_through
from gsjax.meshing.poisson import PoissonOptions
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera
from gsjax.scene.colors import to_bytes

NormalsOfDepth = Callable[[np.ndarray, np.ndarray, Camera], np.ndarray]
"""Depth and alphas `[H, W]`, camera -> `[H, W, 3]` unit normals in its frame, towards it; zero where there is none."""

LEAST_FACING = 0.15  # Cosine between normal and ray: what is seen at a flatter angle is an edge, or off by much.


def depth_poisson(
    normals_of: NormalsOfDepth,
    num_points: int,
    reconstruction: PoissonOptions | None = None,
    *,
    min_alpha: float = 0.5,
    seed: int = 0,
) -> Method:
    """Poisson through random pixels of the rendered depth, with normals of that depth.

    The level set has the bumps of every Gaussian; composited depth is the mean over several. Where splats of the near
    and the far mix, at outlines, there is no surface: `normals_of` says so by a zero.

    Args:
        normals_of: Such as `gsjax.normals.from_depth.smoothed_depth_normals`.
        num_points: Most points, over all views.
        reconstruction: Of the Poisson stage. None: its defaults.
        min_alpha: Pixels covered less show no surface.
        seed: Of the random choice of pixels.
    """

    def from_depth(gaussians: Gaussians, cameras: Sequence[Camera], pictures: Iterable[Picture]) -> SurfaceSamples:
        rng, wanted = np.random.default_rng(seed), num_points // max(len(cameras), 1) + 1
        views = [
            _points_of_view(index, camera, picture, normals_of, wanted, min_alpha, rng)
            for index, (camera, picture) in enumerate(zip(cameras, pictures, strict=True))
        ]
        if not sum(len(points) for points, _, _ in views):
            raise NoSurfaceError(
                f"no surface to extract: no pixel of {len(views)} views has alpha > {min_alpha} and a normal"
            )
        points, normals, colors = (np.concatenate(parts) for parts in zip(*views, strict=True))
        build = poisson_through(gaussians, points, normals, colors, reconstruction)
        return SurfaceSamples(points, build, {"points": len(points)})

    return from_depth


def _points_of_view(
    index: int,
    camera: Camera,
    picture: Picture,
    normals_of: NormalsOfDepth,
    count: int,
    min_alpha: float,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, outward normals and colours of some pixels of one view."""
    level_set.check_sizes(index, camera, picture)
    depth, alphas = np.asarray(picture.depth), np.asarray(picture.alphas)
    covered = level_set.shows_surface(picture, min_alpha)
    depth = np.where(covered, depth, 0)
    normals = np.asarray(normals_of(depth, np.where(covered, alphas, 0), camera), np.float64)
    rows, columns = np.nonzero(covered & np.any(normals != 0, axis=-1))
    points, directions = level_set.world_points(camera, depth, rows, columns)
    outward = normals[rows, columns] @ np.asarray(camera.viewmat, np.float64)[:3, :3]
    facing = np.flatnonzero(np.sum(outward * directions, axis=-1) < -LEAST_FACING)
    drawn = rng.permutation(facing)[:count]
    colors = to_bytes(np.asarray(picture.colors)[rows[drawn], columns[drawn]])
    return points[drawn].astype(np.float32), outward[drawn].astype(np.float32), colors
