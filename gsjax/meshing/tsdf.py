"""Fusion of the rendered depth into a truncated signed distance field, and its zero set: no wall is invented."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from gsjax.errors import NoSurfaceError
from gsjax.gaussians import Gaussians
from gsjax.io.machine import require_memory
from gsjax.io.packages import require
from gsjax.meshing import level_set
from gsjax.meshing.mesh_method import Method, SurfaceSamples, typical_scale
from gsjax.meshing.regions import Region
from gsjax.rendering.gallery import Picture
from gsjax.scene.cameras import Camera
from gsjax.scene.colors import to_bytes
from gsjax.scene.meshes import Mesh, canonical_order

VOXEL_PER_SCALE = 0.75  # Voxels much smaller than the Gaussians reproduce their bumps.
MOST_VOXELS = 512  # Along the longest side of a region, where the size is chosen.
TRUNCATION = 3.0  # Voxels on both sides of the depth that a view speaks about: more grow fringes, fewer leave slits.
BLOCK = 8  # Voxels along the side of a block, of which the grid has as many as the surface touches.
TOUCHED = 4  # Open3D finds the blocks of a view by every fourth pixel.
BYTES_PER_VOXEL = 20  # distance, weight and colour
LEAST_FACING = 0.35  # Cosine between normal and ray: depth of what is seen at a flatter angle is off by much.
SMOOTHED, STEP = 8, 0.5  # Rounds in which a vertex moves by a share of the way to its neighbours' mean.
SEEN_ONCE = 0.5  # A voxel that one view speaks about counts.
POINTS_PER_VIEW = 2_000  # Of the depth, to choose the regions by.


NormalsOfDepth = Callable[[np.ndarray, np.ndarray, Camera], np.ndarray]
"""Depth and alphas `[H, W]`, camera -> `[H, W, 3]` unit normals in its frame, towards it; zero where there is none."""


class DepthView(NamedTuple):
    """One view as it is fused: 7 bytes a pixel."""

    camera: Camera
    depth: np.ndarray  # [H, W] float32 camera z, 0 where nothing
    colors: np.ndarray  # [H, W, 3] uint8


def tsdf(normals_of: NormalsOfDepth, *, voxel: float | None = None) -> Method:
    """Surface by fusion of depth, Open3D's on the CPU, smoothed.

    What no view has seen stays open, and thin parts keep their thickness down to some voxels. Pixels at edges and at
    flat angles take no part. How deep a view reaches is not an option: it is the region, by the points that its pixels
    represent.

    Args:
        normals_of: Normals of the depth, such as `gsjax.normals.from_depth.smoothed_depth_normals`.
        voxel: Its side, scene units. None: three quarters of the median Gaussian's largest standard deviation in the
            region, or a 512th of the region's longest side where that is larger.
    """

    def from_fused_depth(
        gaussians: Gaussians, cameras: Sequence[Camera], pictures: Iterable[Picture]
    ) -> SurfaceSamples:
        views, points = [], [np.zeros((0, 3))]
        rng = np.random.default_rng(0)
        for index, (camera, picture) in enumerate(zip(cameras, pictures, strict=True)):
            level_set.check_sizes(index, camera, picture)
            depth = _facing(picture, camera, normals_of)
            views.append(DepthView(camera, depth, to_bytes(np.asarray(picture.colors))))
            rows, columns = np.nonzero(depth)
            sample = rng.permutation(len(rows))[:POINTS_PER_VIEW]
            points.append(level_set.world_points(camera, depth, rows[sample], columns[sample])[0])
        points = np.concatenate(points)
        if not len(points):
            raise NoSurfaceError(
                f"no surface to extract: no pixel of {len(views)} views has alpha > {level_set.MIN_ALPHA} and a normal"
            )

        def build(region: Region) -> tuple[Mesh, dict]:
            smallest = region.box.longest / MOST_VOXELS
            side = voxel or max(VOXEL_PER_SCALE * typical_scale(gaussians, region), smallest)
            return _smoothed(_fused(views, region.grown(TRUNCATION * side), side)), {"voxel": side}

        return SurfaceSamples(points, build, {"views": len(views)})

    return from_fused_depth


def _facing(picture: Picture, camera: Camera, normals_of: NormalsOfDepth) -> np.ndarray:
    """The picture's depth where its surface has a normal that faces the camera, else 0."""
    is_covered = level_set.shows_surface(picture)
    depth, alphas = (np.where(is_covered, each, 0).astype(np.float32) for each in (picture.depth, picture.alphas))
    rows, columns = np.nonzero(is_covered)
    _, directions = level_set.world_points(camera, depth, rows, columns)
    normals = np.asarray(normals_of(depth, alphas, camera))[rows, columns] @ np.asarray(camera.viewmat)[:3, :3]
    faces = np.sum(normals * directions, axis=-1) < -LEAST_FACING
    depth[rows[~faces], columns[~faces]] = 0
    return depth


def _smoothed(mesh: Mesh) -> Mesh:
    """The mesh with the noise of depth smoothed; its border stays."""
    trimesh = require("trimesh")
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    border = shape.edges_sorted[trimesh.grouping.group_rows(shape.edges_sorted, require_count=1)]
    operator = trimesh.smoothing.laplacian_calculation(shape, pinned_vertices=np.unique(border))
    trimesh.smoothing.filter_laplacian(
        shape, lamb=STEP, iterations=SMOOTHED, volume_constraint=False, laplacian_operator=operator
    )
    return Mesh(np.asarray(shape.vertices, mesh.vertices.dtype), mesh.faces, mesh.colors)


def _fused(views: Sequence[DepthView], region: Region, voxel: float) -> Mesh:
    # The older ScalableTSDFVolume gives no triangles in Open3D 0.20; this grid grows by itself too.
    o3d = require("open3d")
    names, types, widths = ("tsdf", "weight", "color"), (o3d.core.float32,) * 3, (1, 1, 3)
    grid = o3d.t.geometry.VoxelBlockGrid(names, types, widths, voxel_size=voxel, block_resolution=BLOCK)
    for view in views:
        depth = _depth_within(view, region)
        if not depth[::TOUCHED, ::TOUCHED].any():  # Open3D refuses a view whose blocks it finds none of.
            continue
        blocks = np.sum((depth.astype(np.float64) / (view.camera.K[0, 0] * BLOCK * voxel)) ** 2)  # of what it sees
        require_memory(f"a grid of voxels of {voxel:.3g} scene units", BYTES_PER_VOXEL * BLOCK**3 * float(blocks))
        far = float(depth.max()) + voxel
        image = o3d.t.geometry.Image(o3d.core.Tensor(depth))
        colors = o3d.t.geometry.Image(o3d.core.Tensor(view.colors.astype(np.float32) / 255))
        # This grid reads the pixel that a voxel falls in: its centres are at +0.5, as ours are.
        K, viewmat = (o3d.core.Tensor(np.asarray(m, np.float64)) for m in (view.camera.K, view.camera.viewmat))
        blocks = grid.compute_unique_block_coordinates(image, K, viewmat, 1.0, far, TRUNCATION)
        grid.integrate(blocks, image, colors, K, K, viewmat, 1.0, far, TRUNCATION)
    surface = grid.extract_triangle_mesh(weight_threshold=SEEN_ONCE)
    faces = surface.triangle.indices.numpy() if "indices" in surface.triangle else np.zeros((0, 3))
    if not len(faces):
        raise NoSurfaceError(f"no mesh: the depth of {len(views)} views leaves no surface at voxels of {voxel:.4g}")
    mesh = Mesh(
        vertices=surface.vertex.positions.numpy(),
        faces=faces.astype(np.int32),
        colors=to_bytes(surface.vertex.colors.numpy()),
    )
    return canonical_order(mesh)  # Open3D's threads give another order in every run.


def _depth_within(view: DepthView, region: Region) -> np.ndarray:
    """The depth of the pixels whose points are in the region, else 0."""
    rows, columns = np.nonzero(view.depth)
    inside = region.contains(level_set.world_points(view.camera, view.depth, rows, columns)[0])
    depth = np.zeros_like(view.depth)
    depth[rows[inside], columns[inside]] = view.depth[rows[inside], columns[inside]]
    return depth
