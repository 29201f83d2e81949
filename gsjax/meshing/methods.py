"""Ways from Gaussians and rendered views to a surface, all of one signature; `extract_mesh` is handed one of them.

A method looks at every view once. What it brings back, a `Sighting`, says where the surface was seen and builds the
part of it that lies in a region. Here are two that end in a Poisson reconstruction; `depth_points`, `tsdf` and
`marching_cubes` hold the others.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from gsjax import gaussians as gs
from gsjax.cameras import Camera, landing, viewmat_center
from gsjax.colors import to_bytes
from gsjax.errors import NoSurfaceError
from gsjax.gaussians import Gaussians
from gsjax.meshes import Mesh, unit_or_zero
from gsjax.meshing import level_set, poisson
from gsjax.meshing.boxes import Region
from gsjax.meshing.level_set import LevelSetOptions
from gsjax.meshing.poisson import PoissonOptions
from gsjax.nearest import TREE_CHUNK
from gsjax.rendering.gallery import Picture

CELL_PER_SCALE = 1.0  # Poisson cells smaller than the Gaussians reproduce their bumps, not the surface.
RIM = 0.05  # Of the region's, or its inner box's, longest side: points that far outside shape the surface inside.
SEEN_DEVIATIONS = 3.0  # A centre within so many of its standard deviations of the rendered depth is seen.
PLANE_NEIGHBORS = 32  # SuGaR's, of the normals at the centres.


class Sighting(NamedTuple):
    """What a method has gathered from the views."""

    points: np.ndarray  # [P, 3] world: of the surface as it was seen; they say where the regions are
    build: Callable[[Region], tuple[Mesh, dict]]  # the surface in and a little around a region, and plain numbers
    report: dict  # plain numbers


Method = Callable[[Gaussians, Sequence[Camera], Iterable[Picture]], Sighting]


def level_set_poisson(
    options: LevelSetOptions | None = None, reconstruction: PoissonOptions | None = None, *, seed: int = 0
) -> Method:
    """Poisson through points on the level set of the density: SuGaR's and the paper's way.

    Args:
        options: Of the sampling. None: `level_set.options_for` the cameras.
        reconstruction: Of the Poisson stage. None: its defaults.
        seed: Of the random choice of pixels.
    """

    def gather(gaussians: Gaussians, cameras: Sequence[Camera], pictures: Iterable[Picture]) -> Sighting:
        surface = level_set.surface_points(gaussians, cameras, pictures, options, seed=seed)
        report = {
            "kernels": surface.kernels,
            "rays": surface.rays,
            "crossing_share": surface.crossing_share,
            "flipped_share": surface.flipped / surface.crossings,
            "points": len(surface.points),
        }
        build = poisson_through(gaussians, surface.points, surface.normals, surface.colors, reconstruction)
        return Sighting(surface.points, build, report)

    return gather


def centers_poisson(
    reconstruction: PoissonOptions | None = None, *, min_opacity: float = 0.5, neighbors: int = PLANE_NEIGHBORS
) -> Method:
    """Poisson through the centres of the Gaussians: SuGaR's ablation, coarser and quicker.

    The normal is that of the plane through a centre's neighbours, turned to the cameras that see it. A centre that none
    sees has no outside, and is left out.

    Args:
        reconstruction: Of the Poisson stage. None: its defaults.
        min_opacity: Gaussians up to this are left out.
        neighbors: Centres that a plane is put through.
    """

    def gather(gaussians: Gaussians, cameras: Sequence[Camera], pictures: Iterable[Picture]) -> Sighting:
        kept = level_set.opaque_enough(gaussians, min_opacity, neighbors)
        centers = np.asarray(kept.means, np.float64)
        reach = SEEN_DEVIATIONS * np.asarray(gs.scales(kept)).max(axis=1)
        towards = directions_to_viewers(centers, reach, cameras, pictures)
        seen = np.any(towards != 0, axis=1)
        if not seen.any():
            raise NoSurfaceError(f"no surface to extract: no view sees the centre of any of {len(centers)} Gaussians")
        normals = plane_normals(centers, min(neighbors, len(centers)))
        normals *= np.where(np.sum(normals * towards, axis=1, keepdims=True) < 0, -1, 1)
        colors = base_colors(kept)
        build = poisson_through(gaussians, centers[seen], normals[seen], colors[seen], reconstruction)
        return Sighting(centers[seen], build, {"kernels": len(centers), "points": int(seen.sum())})

    return gather


def base_colors(gaussians: Gaussians) -> np.ndarray:
    """`[N, 3]` uint8 sRGB that the degree-0 coefficients alone give."""
    return to_bytes(gs.SH_C0 * np.asarray(gaussians.sh_dc)[:, 0] + 0.5)


def typical_scale(gaussians: Gaussians, region: Region) -> float:
    """Median of the largest standard deviations of the opaque Gaussians in a region (of all, where there is none)."""
    largest = np.asarray(gs.scales(gaussians)).max(axis=1)
    chosen = (np.asarray(gaussians.logit_opacities) > 0) & region.contains(np.asarray(gaussians.means))
    return float(np.median(largest[chosen] if chosen.any() else largest))


def directions_to_viewers(
    points: np.ndarray, reach: np.ndarray, cameras: Sequence[Camera], pictures: Iterable[Picture]
) -> np.ndarray:
    """`[P, 3]` sum of the unit directions towards the cameras that see each point; zero where none does.

    Args:
        points: `[P, 3]` world.
        reach: `[P]` how far a point may lie from the rendered depth, scene units.
        cameras: One camera a view.
        pictures: One picture a camera.
    """
    total = np.zeros_like(points)
    for index, (camera, picture) in enumerate(zip(cameras, pictures, strict=True)):
        level_set.check_sizes(index, camera, picture)
        viewmat, size = np.asarray(camera.viewmat, np.float64), (camera.height, camera.width)
        rows, columns, depths, inside = landing(points, viewmat, np.asarray(camera.K), size)
        rendered = np.asarray(picture.depth)[rows, columns]
        sees = inside & (rendered > 0) & (np.abs(rendered - depths) < reach)
        towards = viewmat_center(viewmat) - points[sees]
        total[sees] += unit_or_zero(towards)
    return total


def plane_normals(points: np.ndarray, neighbors: int) -> np.ndarray:
    """`[P, 3]` unit normals, of either sign, of the planes through each point and its nearest neighbours."""
    tree = KDTree(points)
    normals = np.empty_like(points)
    for start in range(0, len(points), TREE_CHUNK):
        part = slice(start, start + TREE_CHUNK)
        around = points[np.asarray(tree.query(points[part], neighbors, workers=-1)[1]).reshape(-1, neighbors)]
        offsets = around - around.mean(axis=1, keepdims=True)
        normals[part] = np.linalg.eigh(np.einsum("pki,pkj->pij", offsets, offsets))[1][:, :, 0]
    return normals


def poisson_through(
    gaussians: Gaussians,
    points: np.ndarray,
    normals: np.ndarray,
    colors: np.ndarray,
    options: PoissonOptions | None,
) -> Callable[[Region], tuple[Mesh, dict]]:
    """A method's `build` from points, outward normals and colours, each `[P, 3]`."""

    def build(region: Region) -> tuple[Mesh, dict]:
        chosen = region.grown(RIM * (region.without or region.box).longest).contains(points)
        cell = CELL_PER_SCALE * typical_scale(gaussians, region)
        mesh, report = poisson.reconstruct(points[chosen], normals[chosen], colors[chosen], options, smallest_cell=cell)
        return mesh, asdict(report)

    return build
