"""From oriented points to triangles: Open3D's screened Poisson reconstruction, trimmed to where there are points.

A Poisson surface is always closed: where there are no points it invents a membrane. Two numbers reveal an invented
vertex: its distance from the nearest point, and the reconstruction's own density of points around it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree

from gsjax.errors import NoSurfaceError
from gsjax.io.packages import require
from gsjax.meshing.cleaning import mesh_of_open3d
from gsjax.meshing.connectivity import connected_labels, edge_table
from gsjax.scene.meshes import Mesh

DEPTHS = (6, 10)  # Coarsest and finest octree that is chosen unasked; SuGaR takes 10, and 6 to 8 against bumps.
MIN_POINTS = 100
SCALE = 1.1  # Of the octree's cube over the longest side of the points' box, at least.
OUTLIER_NEIGHBORS, OUTLIER_RATIO = 20, 20.0  # Of the statistical filter: standard deviations beyond the mean distance.
TRIM_CELLS = 5.0  # Holes up to twice as wide are bridged, and open ends grow by as much: cells, or
TRIM_SPACINGS = 4.0  # spacings of the points where those are longer; half of it is near.
THINNEST_SUPPORTED = 0.005  # The quantile of the supported vertices' densities that counts as their lower end.
THREADS = 1  # With more, equal input gives meshes that differ in the last bits.


@dataclass(frozen=True)
class Support:
    """V vertices of a reconstruction, and what the points say about them."""

    distances: np.ndarray  # [V] to the nearest point, scene units
    densities: np.ndarray  # [V] of points around, any increasing measure
    edges: np.ndarray  # [E, 2] vertex ids
    near: float  # scene units: vertices up to here are supported
    far: float  # scene units: vertices beyond are guesses


class Cut(NamedTuple):
    """What to take away."""

    vertices: np.ndarray  # [V] bool
    quantile: float  # share of the vertices that go for their density alone


Trim = Callable[[Support], Cut]


def reconstruct(
    points: np.ndarray,
    normals: np.ndarray,
    colors: np.ndarray,
    *,
    depth: int | None = None,
    trim: Trim | None = None,
    smallest_cell: float = 0.0,
) -> tuple[Mesh, dict]:
    """The surface through oriented points, cut off where it is only a guess.

    Args:
        points: `[P, 3]` world positions.
        normals: `[P, 3]` unit, outward.
        colors: `[P, 3]` uint8 sRGB.
        depth: Of the octree. None: cells of twice the points' spacing, but no finer than `smallest_cell`.
        trim: What is cut off. None: `adaptive`.
        smallest_cell: Scene units; cells smaller than the Gaussians reproduce their bumps, not the surface.

    Returns:
        An oriented mesh with the points' colours, counter-clockwise seen from outside; and a report: `points_used` in
        the region and its rim after the outliers went, `depth`, `cell`, the side of the finest, `trim_quantile`, the
        share of the vertices cut for their density, and `trim_distance`, beyond which vertices were cut, scene units.

    Raises:
        NoSurfaceError: Fewer than 100 points, or nothing is left after trimming.
    """
    o3d = require("open3d")
    cloud = _without_outliers(points, normals, colors)
    inliers = np.asarray(cloud.points)
    if len(inliers) < MIN_POINTS:
        raise NoSurfaceError(f"no mesh: {len(inliers)} surface points, Poisson reconstruction needs {MIN_POINTS}")
    gap, extent, scale = spacing(inliers), float(np.ptp(inliers, axis=0).max()), SCALE
    if depth is None:
        depth, scale = octree_for_cell(extent, max(2 * gap, smallest_cell), SCALE)
    cell = scale * extent / 2**depth
    far = max(TRIM_SPACINGS * gap, TRIM_CELLS * cell)

    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        surface, densities = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
            cloud, depth=depth, scale=scale, n_threads=THREADS
        )
    distances = np.asarray(KDTree(inliers).query(np.asarray(surface.vertices), workers=-1)[0])
    edges = edge_table(np.asarray(surface.triangles)).pairs
    cut = (trim or adaptive)(Support(distances, np.asarray(densities), edges, near=far / 2, far=far))
    surface.remove_vertices_by_mask(cut.vertices)
    if not len(surface.triangles):
        raise NoSurfaceError(f"no mesh: no Poisson vertex is supported by the {len(inliers)} points (within {far:.4g})")
    report = {"points_used": len(inliers), "depth": depth, "cell": cell}
    return mesh_of_open3d(surface), report | {"trim_quantile": cut.quantile, "trim_distance": float(far)}


def _without_outliers(points: np.ndarray, normals: np.ndarray, colors: np.ndarray) -> Any:
    """A point cloud of Open3D."""
    o3d = require("open3d")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
    cloud.normals = o3d.utility.Vector3dVector(normals.astype(np.float64))
    cloud.colors = o3d.utility.Vector3dVector(colors / 255.0)
    if len(points) > OUTLIER_NEIGHBORS:
        cloud = cloud.remove_statistical_outlier(OUTLIER_NEIGHBORS, OUTLIER_RATIO)[0]
    return cloud


def spacing(points: np.ndarray) -> float:
    """Median distance from a point to its nearest other, scene units."""
    sample = points[:: max(len(points) // 20_000, 1)]
    return float(np.median(KDTree(points).query(sample, 2, workers=-1)[0][:, 1]))


def octree_for_cell(extent: float, cell: float, scale: float) -> tuple[int, float]:
    """Depth, from 6 to 10, and scale, at least the given one, of an octree whose finest cells are of side `cell`.

    An octree halves its cube, so the cube is made larger until a whole number of halvings fits. Cells are larger than
    requested where depth 10 is not enough, and smaller where 6 is too much. The scale is that of the cube over the
    points' box, whose longest side is `extent`, scene units.
    """
    halvings = np.ceil(np.log2(scale * extent / max(cell, 1e-6 * extent)))
    depth = int(np.clip(halvings, *DEPTHS))
    return depth, float(np.clip(cell * 2**depth / extent, scale, 2 * scale))


def adaptive(support: Support) -> Cut:
    """Cuts what is far from every point, and what is too thin and leads there.

    Too thin is a vertex that is not near a point and below the lower end of the densities of those that are: no number
    is chosen by hand. A thin patch with support all around bridges a small hole, and stays.
    """
    is_near, is_far = support.distances <= support.near, support.distances > support.far
    if not is_near.any():
        return Cut(is_far, 0.0)
    too_thin = ~is_near & (support.densities < np.quantile(support.densities[is_near], THINNEST_SUPPORTED))
    unsound = is_far | too_thin
    patch = connected_labels(support.edges[unsound[support.edges].all(axis=1)], len(unsound))
    leads_far = np.zeros(len(unsound), bool)
    leads_far[patch[is_far]] = True
    cut = unsound & leads_far[patch]
    return Cut(cut, float((cut & ~is_far).mean()))


def at_quantile(quantile: float) -> Trim:
    """Cuts what is far from every point, and the given share of the vertices, the least dense ones (SuGaR: 0.1)."""

    def trim(support: Support) -> Cut:
        thin = support.densities < np.quantile(support.densities, quantile)
        return Cut(thin | (support.distances > support.far), quantile)

    return trim
