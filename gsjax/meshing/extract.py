"""From Gaussians and their rendered depth to a clean mesh: level set, Poisson, trimming, cleaning."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from gsjax import gaussians as gs
from gsjax import level_set
from gsjax.cameras import Camera
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.level_set import SurfacePoints
from gsjax.mesh import Mesh
from gsjax.meshing import poisson
from gsjax.meshing.cleaning import clean

CELL_PER_SCALE = 1.0  # Poisson cells smaller than the Gaussians reproduce their bumps, not the surface.
Bounds = tuple[np.ndarray, np.ndarray]  # (min [3], max [3]), world, scene units


def extract_mesh(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    depths: Sequence[np.ndarray],
    alphas: Sequence[np.ndarray],
    colors: Sequence[np.ndarray],
    *,
    level: float = 0.3,
    min_opacity: float = 0.5,
    num_points: int = 300_000,
    bounds: Bounds | None = None,
    depth: int | None = None,
    trim_quantile: float = 0.0,
    min_component_share: float = 0.01,
    max_faces: int | None = 1_000_000,
    seed: int = 0,
) -> tuple[Mesh, dict]:
    """The mesh of the surface that the cameras see.

    One reconstruction covers everything inside the bounds, at one cell size. (A near and a far part, each at its own
    resolution, are two calls with two bounds and a merge.)

    Args:
        gaussians: The trained scene.
        cameras: One camera a view.
        depths: One `[H, W]` expected depth a view, camera z, scene units.
        alphas: One `[H, W]` accumulated opacity a view.
        colors: One `[H, W, 3]` rendered image a view, 0..1.
        level: Density of the surface.
        min_opacity: Gaussians up to this opacity make no density (the entropy phase leaves few of them).
        num_points: Most surface points that the reconstruction is given.
        bounds: (min `[3]`, max `[3]`) of the box to reconstruct, world; taken as it is. None: `robust_bounds`.
        depth: Octree depth of the Poisson reconstruction. None: cells no smaller than the median Gaussian's largest
            standard deviation or twice the points' spacing, 6 to 10.
        trim_quantile: Share of Poisson vertices cut off for low point density.
        min_component_share: Connected pieces smaller than this share of the largest one are dropped.
        max_faces: Most triangles; above it the mesh is decimated.
        seed: Of the random choice of pixels.

    Returns:
        The mesh, and a report of plain numbers: `level_set`, `bounds`, `depth` and `cleaning`.

    Raises:
        InputError: No point lies on the level set, none in the bounds, or no triangle survives.
    """
    surface = level_set.surface_points(
        gaussians,
        cameras,
        depths,
        alphas,
        colors,
        level=level,
        num_points=num_points,
        min_opacity=min_opacity,
        seed=seed,
    )
    box = robust_bounds(surface.points) if bounds is None else bounds
    inside = _inside(surface.points, box)
    points = surface.points[inside]
    if depth is None:
        depth = _octree_depth(gaussians, points)
    rough = poisson.reconstruct(
        points, surface.normals[inside], surface.colors[inside], depth=depth, trim_quantile=trim_quantile
    )
    mesh, cleaning = clean(rough, min_component_share=min_component_share, max_faces=max_faces)
    return mesh, {
        "level_set": _counts(surface),
        "points_in_bounds": len(points),
        "bounds": [np.asarray(corner, float).tolist() for corner in box],
        "depth": depth,
        "cleaning": asdict(cleaning),
    }


def robust_bounds(points: np.ndarray) -> Bounds:
    """The box of the middle 98 % of the points along every axis, grown by a tenth of its size on each side."""
    low, high = np.quantile(points, [0.01, 0.99], axis=0)
    margin = 0.1 * (high - low).max()
    return low - margin, high + margin


def _inside(points: np.ndarray, bounds: Bounds) -> np.ndarray:
    """`[P]` bool; InputError where no point is in the box."""
    low, high = (np.asarray(corner, float) for corner in bounds)
    if low.shape != (3,) or high.shape != (3,) or not np.all(low < high):
        raise InputError(f"bounds must be a min below a max along x, y and z, not {low.tolist()} and {high.tolist()}")
    inside = np.all((points >= low) & (points <= high), axis=1)
    if not inside.any():
        raise InputError(
            f"no mesh: the bounds {low.tolist()} to {high.tolist()} hold none of {len(points)} surface points, "
            f"which span {points.min(0).tolist()} to {points.max(0).tolist()}"
        )
    return inside


def _octree_depth(gaussians: Gaussians, points: np.ndarray) -> int:
    """Cells as fine as the Gaussians (the opaque ones) and the points can support."""
    opaque = np.asarray(gaussians.logit_opacities) > 0
    largest = np.asarray(gs.scales(gaussians)).max(axis=1)
    typical = float(np.median(largest[opaque] if opaque.any() else largest))
    return poisson.depth_for_cell(points, max(CELL_PER_SCALE * typical, 2 * poisson.spacing(points)))


def _counts(surface: SurfacePoints) -> dict:
    return {
        "kernels": surface.kernels,
        "rays": surface.rays,
        "crossing_share": surface.crossing_share,
        "flipped_share": surface.flipped / surface.crossings,
        "points": len(surface.points),
    }
