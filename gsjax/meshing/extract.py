"""From Gaussians and their rendered views to a clean mesh: see, choose regions, reconstruct each, clean, join."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from gsjax.errors import InputError, NoSurfaceError
from gsjax.gaussians import Gaussians, without_view_dependence
from gsjax.meshing.cleaning import clean, concatenate_meshes
from gsjax.meshing.connectivity import topology
from gsjax.meshing.level_set import level_set_poisson
from gsjax.meshing.mesh_method import Method, SurfaceSamples, method_name
from gsjax.meshing.pictures import rays_in_bands
from gsjax.meshing.ray_queries import ray_caster
from gsjax.meshing.regions import Region, Regions, near_and_far
from gsjax.rendering import gallery
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera
from gsjax.scene.meshes import Mesh
from gsjax.scene.similarity import IDENTITY, Similarity

LENGTHS = frozenset({"cell", "voxel", "trim_distance", "boundary_length", "largest_hole"})
"""What in a report has units of the scene."""
SIDE = 64  # Rays along the longer side of a view: enough to tell a share.
MOST_VIEWS = 24


def extract_mesh(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    pictures: Iterable[Picture] | None = None,
    *,
    method: Method | None = None,
    regions: Callable[[np.ndarray], Regions] = near_and_far,
    max_faces: int | None = 1_000_000,
    similarity: Similarity = IDENTITY,
) -> tuple[Mesh, dict]:
    """The mesh of the surface that the cameras see.

    Each region is reconstructed by itself, at its own resolution, cut off at its border, cleaned, and joined to the
    others without stitching.

    Args:
        gaussians: The trained scene.
        cameras: One camera a view.
        pictures: One rendered picture a camera, in order, with the owners that `level_set_poisson` reads; a
            generator will do. None: they are drawn here, in the constant colour of the Gaussians, over black.
        method: How the surface is found: any function of this signature, such as the makers that
            `gsjax.meshing.methods.METHODS` lists return. None: `level_set_poisson()`.
        regions: Where it is reconstructed, from the `[P, 3]` points at which it was seen. A region that is given is
            taken as it is.
        max_faces: Most triangles of a region; above it, it is decimated.
        similarity: To these coordinates, which the mesh has too, from those that the report is in.

    Returns:
        The mesh, and a report: the name of the `method`, `seen` (by the method), one entry a region, `topology`, and
        `facing_share` (of the view rays, those whose first triangle faces the camera).

    Raises:
        InputError: There is no camera, a picture lacks what the method reads, there is no surface, none in any
            region, or no triangle survives.
    """
    if not cameras:
        raise InputError("no mesh: there is no camera to look from")
    if pictures is None:
        pictures = gallery.pictures(without_view_dependence(gaussians), cameras, np.zeros(3), with_owners=True)
    method = level_set_poisson() if method is None else method
    samples = method(gaussians, cameras, pictures)
    parts, reports, faults = [], {}, []
    for name, region in regions(samples.points).items():
        try:
            part, reports[name] = _part(samples, region, max_faces, similarity)
            parts.append(part)
        except InputError as fault:
            reports[name] = {"box": region.corners(similarity), "empty": str(fault)}
            faults.append(f"{name}: {fault}")
    if not parts:
        raise NoSurfaceError("; ".join(faults))
    mesh, facing = orient_outward(concatenate_meshes(parts), cameras)
    report = {
        "method": method_name(method),
        "seen": samples.report,
        **reports,
        "topology": topology(mesh),
        "facing_share": facing,
    }
    return mesh, similarity.figures_to_world(report, LENGTHS)


def _part(samples: SurfaceSamples, region: Region, max_faces: int | None, similarity: Similarity) -> tuple[Mesh, dict]:
    """The clean mesh of one region; NoSurfaceError where there is none."""
    count = int(region.contains(samples.points).sum())
    if not count:
        low, high = region.corners(similarity)
        ends = (similarity.points_to_world(end(samples.points, axis=0)) for end in (np.min, np.max))
        first, last = (end.round(3).tolist() for end in ends)
        raise NoSurfaceError(
            f"no mesh: the box {low} to {high} holds none of {len(samples.points)} surface points, "
            f"which span {first} to {last}"
        )
    rough, build_report = samples.build(region)
    mesh, cleaning = clean(cut_to_region(rough, region), max_faces=max_faces)
    return mesh, {"box": region.corners(similarity), "points_seen": count, **build_report, "cleaning": cleaning}


def cut_to_region(mesh: Mesh, region: Region) -> Mesh:
    """The triangles with a corner in the region, so that parts overlap by a triangle and leave no crack."""
    corners = mesh.vertices[mesh.faces]
    is_inside = region.contains(corners.reshape(-1, 3)).reshape(-1, 3).any(axis=1)
    return Mesh(mesh.vertices, mesh.faces[is_inside], mesh.colors)


def facing_share(mesh: Mesh, cameras: Sequence[Camera]) -> float:
    """Share of the view rays whose first triangle faces the camera, over up to 24 views; 1 where no ray hits.

    A sound mesh has 0.99 and more; what is missing looks through a hole at an inner side.
    """
    cast = ray_caster(mesh)
    indices = np.unique(np.linspace(0, len(cameras) - 1, min(MOST_VIEWS, len(cameras))).astype(int))
    hits = [hits for index in indices for hits, _ in rays_in_bands(mesh, cast, _small(cameras[index]), 1)]
    is_facing = np.concatenate([np.sum(each.normals * each.rays, axis=1) < 0 for each in hits])
    return float(is_facing.mean()) if len(is_facing) else 1.0


def orient_outward(mesh: Mesh, cameras: Sequence[Camera]) -> tuple[Mesh, float]:
    """The mesh, its faces turned about if most of them look away from the views, and its facing share then."""
    share = facing_share(mesh, cameras)
    if share < 1 - share:
        return Mesh(mesh.vertices, np.ascontiguousarray(mesh.faces[:, ::-1]), mesh.colors), 1 - share
    return mesh, share


def _small(camera: Camera) -> Camera:
    """The view with up to 64 pixels along its longer side."""
    factor = min(1.0, SIDE / max(camera.width, camera.height))
    width, height = (max(round(factor * side), 1) for side in (camera.width, camera.height))
    K = np.diag([width / camera.width, height / camera.height, 1]) @ np.asarray(camera.K, np.float64)
    return Camera(camera.viewmat, K, width, height)
