"""Holes of a mesh are closed where views show a surface; what no view observes, or views see through, stays open."""

from collections.abc import Sequence

import numpy as np

from gsjax.io.packages import require
from gsjax.meshing.connectivity import edge_table, face_components
from gsjax.rendering.coarse_depths import SAME_SURFACE, CoarseDepth, depths_at
from gsjax.scene.meshes import Mesh, face_area_vectors

WIDEST = 0.05  # Radius of a hole, of the diagonal of the mesh's box: what is wider is an opening.
PER_PATCH = 32  # Points at which the views are asked about a patch.
SUPPORTING = 2  # Views that show a surface at such a point: one alone may be wrong.


def fill_holes(mesh: Mesh, views: Sequence[CoarseDepth]) -> tuple[Mesh, dict[str, int]]:
    """Closes a hole where at most of its points at least two views show a surface, and no fewer than look through it.

    A view supports a point whose depth is within `SAME_SURFACE` of the one that it shows there, and looks through the
    point where it shows a greater one. The patches are Open3D's (VTK's): triangles between vertices of the rim. The
    mesh is oriented and clean.

    Returns:
        The mesh with the same vertices and more triangles, oriented like those around them; and a report: `patches`
        over holes that are no wider than `WIDEST`, and those `closed`, with `closed_faces`: which views support, and
        whose triangles fit between those that were there.
    """
    patches = _patches(mesh)
    if not len(patches):
        return mesh, {"patches": 0, "closed": 0, "closed_faces": 0}
    labels, sizes = face_components(patches, edge_table(patches))
    is_seen = _are_seen(mesh, patches, labels, len(sizes), views)[labels]
    patches, labels = patches[is_seen], labels[is_seen]
    added = _oriented_like(mesh.faces, patches, labels, len(sizes))
    fits = ~np.isin(labels, labels[_conflicts(mesh.faces, added)])
    added, labels = added[fits], labels[fits]
    whole = Mesh(mesh.vertices, np.concatenate([mesh.faces, added]).astype(np.int32), mesh.colors)
    return whole, {"patches": len(sizes), "closed": len(np.unique(labels)), "closed_faces": len(added)}


def _patches(mesh: Mesh) -> np.ndarray:
    """`[F, 3]` triangles that close every hole that is not too wide."""
    o3d = require("open3d")
    vertices = np.ascontiguousarray(mesh.vertices, np.float64)
    surface = o3d.t.geometry.TriangleMesh(o3d.core.Tensor(vertices), o3d.core.Tensor(mesh.faces.astype(np.int64)))
    radius = WIDEST * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    # They follow the triangles that were there.
    return surface.fill_holes(hole_size=radius).triangle.indices.numpy()[mesh.num_faces :]


def _are_seen(
    mesh: Mesh, patches: np.ndarray, labels: np.ndarray, count: int, views: Sequence[CoarseDepth]
) -> np.ndarray:
    """`[count]` bool: whether views support most of each patch."""
    rng = np.random.default_rng(0)
    areas = np.linalg.norm(face_area_vectors(Mesh(mesh.vertices, patches, mesh.colors)), axis=1)
    # Every patch is asked at `PER_PATCH` points, spread over its area.
    order = np.argsort(labels, kind="stable")
    running = np.cumsum(areas[order] + 1e-12 * areas.max() + np.finfo(float).tiny)
    ends = running[np.searchsorted(labels[order], np.arange(count), side="right") - 1]
    begins = np.concatenate([[0.0], ends[:-1]])
    at = begins[:, None] + rng.random((count, PER_PATCH)) * (ends - begins)[:, None]
    faces = patches[order[np.minimum(np.searchsorted(running, at.ravel()), len(order) - 1)]]
    weights = rng.dirichlet(np.ones(3), len(faces))
    points = np.einsum("pk,pkd->pd", weights, mesh.vertices.astype(np.float64)[faces])
    supporting, through = np.zeros((2, len(points)), np.int32)
    for view in views:
        depths, surface_depths = depths_at(points, view)
        supporting += (surface_depths > 0) & (np.abs(depths - surface_depths) <= SAME_SURFACE * surface_depths)
        through += (surface_depths > 0) & (depths < (1 - SAME_SURFACE) * surface_depths)
    backed = (supporting >= SUPPORTING) & (supporting >= through)
    return backed.reshape(count, PER_PATCH).mean(axis=1) > 0.5


def _oriented_like(faces: np.ndarray, patches: np.ndarray, labels: np.ndarray, count: int) -> np.ndarray:
    """The patches, turned about where they run along the rim in the direction in which the triangles there do."""
    base = int(faces.max()) + 1
    same = np.isin(_directed(patches, base), _directed(faces, base)).reshape(-1, 3).sum(axis=1)
    turned = np.bincount(labels, same, count) > 0
    return np.where(turned[labels][:, None], patches[:, ::-1], patches)


def _conflicts(faces: np.ndarray, added: np.ndarray) -> np.ndarray:
    """`[A]` bool: added triangles with an edge that another triangle has in the same direction."""
    both = np.concatenate([faces, added])
    _, places, counts = np.unique(_directed(both, int(both.max()) + 1), return_inverse=True, return_counts=True)
    return np.any(counts[places].reshape(-1, 3) > 1, axis=1)[len(faces) :]


def _directed(faces: np.ndarray, base: int) -> np.ndarray:
    """`[3 F]` one integer a directed edge."""
    starts, ends = faces.astype(np.int64), np.roll(faces, -1, axis=1).astype(np.int64)
    return (starts * base + ends).ravel()
