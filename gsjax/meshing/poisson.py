"""From oriented points to triangles: Open3D's screened Poisson reconstruction, trimmed to where there are points."""

import numpy as np
from scipy.spatial import KDTree

from gsjax.errors import InputError
from gsjax.mesh import Mesh
from gsjax.meshing.libraries import load_open3d

DEPTHS = (6, 10)  # Coarsest and finest octree that is chosen unasked; SuGaR takes 10, and 6 to 8 against bumps.
GROWTH = 1.1  # Open3D's octree cube over the longest side of the points' box.
OUTLIER_NEIGHBORS, OUTLIER_RATIO = 20, 20.0  # SuGaR's statistical filter: very lax.
MIN_POINTS = 100
TRIM_CELLS, TRIM_SPACINGS = 4.0, 4.0  # Holes up to twice this wide are bridged, and open ends grow by as much.


def reconstruct(
    points: np.ndarray,
    normals: np.ndarray,
    colors: np.ndarray,
    *,
    depth: int | None = None,
    trim_quantile: float = 0.0,
    trim_distance: float | None = None,
) -> Mesh:
    """The surface through oriented points, cut off where it is only a guess.

    Open3D runs on one thread here: with more, equal input gives meshes that differ in the last bits.

    Args:
        points: `[P, 3]` world positions.
        normals: `[P, 3]` unit, outward.
        colors: `[P, 3]` uint8 sRGB.
        depth: Octree depth: the finest cell is 1.1 x longest side / 2^depth. None: cells of about twice the
            spacing of the points, depth 6 to 10.
        trim_quantile: Share of the vertices cut off for having the fewest points around them (SuGaR: 0.1). It cuts
            into closed, well sampled surfaces too, so none by default.
        trim_distance: Vertices farther than this from every point are cut off, scene units. None: 4 cells, or 4
            spacings where those are longer.

    Returns:
        An oriented mesh with the points' colours, counter-clockwise seen from outside.

    Raises:
        InputError: Fewer than 100 points, or nothing is left after trimming.
    """
    cloud = _without_outliers(_as_cloud(points, normals, colors))
    kept = np.asarray(cloud.points)
    if len(kept) < MIN_POINTS:
        raise InputError(f"no mesh: {len(kept)} surface points, Poisson reconstruction needs {MIN_POINTS}")
    gap = spacing(kept)
    if depth is None:
        depth = depth_for_cell(kept, 2 * gap)
    if trim_distance is None:
        trim_distance = max(TRIM_SPACINGS * gap, TRIM_CELLS * cell_size(kept, depth))

    surface, densities = _poisson(cloud, depth)
    far = KDTree(kept).query(np.asarray(surface.vertices), workers=-1)[0] > trim_distance
    thin = densities < np.quantile(densities, trim_quantile)
    surface.remove_vertices_by_mask(far | thin)
    if not len(surface.triangles):
        raise InputError(
            f"no mesh: no Poisson vertex lies within {trim_distance:.4g} of the {len(kept)} points; widen the trim"
        )
    return Mesh(
        vertices=np.asarray(surface.vertices, np.float32),
        faces=np.asarray(surface.triangles, np.int32),
        colors=np.clip(np.round(np.asarray(surface.vertex_colors) * 255), 0, 255).astype(np.uint8),
    )


def spacing(points: np.ndarray) -> float:
    """Median distance from a point to its nearest other, scene units."""
    sample = points[:: max(len(points) // 20_000, 1)]
    return float(np.median(KDTree(points).query(sample, 2, workers=-1)[0][:, 1]))


def cell_size(points: np.ndarray, depth: int) -> float:
    """Finest cell of an octree of that depth around the points, scene units."""
    return float(GROWTH * np.ptp(points, axis=0).max() / 2**depth)


def depth_for_cell(points: np.ndarray, cell: float) -> int:
    """The deepest octree, from 6 to 10, whose finest cell is no smaller than `cell` (scene units)."""
    side = GROWTH * np.ptp(points, axis=0).max()
    return int(np.clip(np.floor(np.log2(side / max(cell, 1e-6 * side))), *DEPTHS))


def _as_cloud(points: np.ndarray, normals: np.ndarray, colors: np.ndarray):
    if not points.shape == normals.shape == colors.shape == (len(points), 3):
        raise ValueError(f"{points.shape=}, {normals.shape=}, {colors.shape=} must all be [P, 3]")
    o3d = load_open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
    cloud.normals = o3d.utility.Vector3dVector(normals.astype(np.float64))
    cloud.colors = o3d.utility.Vector3dVector(colors / 255.0)
    return cloud


def _without_outliers(cloud):
    if len(cloud.points) <= OUTLIER_NEIGHBORS:
        return cloud
    return cloud.remove_statistical_outlier(OUTLIER_NEIGHBORS, OUTLIER_RATIO)[0]


def _poisson(cloud, depth: int):
    o3d = load_open3d()
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        surface, densities = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
            cloud, depth=depth, scale=GROWTH, linear_fit=False, n_threads=1
        )
    return surface, np.asarray(densities)
