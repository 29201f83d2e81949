"""Taking out of a mesh what no later stage should have to expect, and saying what was there."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gsjax.errors import NoSurfaceError
from gsjax.io.packages import require
from gsjax.meshing.connectivity import edge_table, face_components
from gsjax.scene.meshes import Mesh, face_area_vectors


def clean(
    mesh: Mesh, *, min_component_share: float = 0.01, max_faces: int | None = None
) -> tuple[Mesh, dict[str, int]]:
    """Merge equal vertices, remove degenerate, duplicate, non-manifold and isolated triangles, then decimate.

    Args:
        mesh: Any mesh.
        min_component_share: Connected pieces with fewer faces than this share of the largest one are taken out.
        max_faces: Above this number of triangles, quadric decimation reduces it. None: never.

    Returns:
        The mesh without unused vertices, and what was taken out: `degenerate_faces`, with a corner twice or no area;
        `duplicate_faces`, the same three corners again; `non_manifold_faces`, smaller ones at edges of more than two
        triangles; `small_components` and `small_component_faces` with them; `decimated_faces`, saved by decimation.

    Raises:
        NoSurfaceError: Nothing is left.
    """
    merged, degenerate, duplicate = _distinct_faces(_merge_vertices(mesh))
    manifold = _manifold(merged)
    large_parts, small, small_faces = _large_components(manifold, min_component_share)
    decimated = _decimate(large_parts, max_faces)
    result = _without_unused_vertices(decimated)
    if not result.num_faces:
        raise NoSurfaceError(f"no mesh: nothing of {mesh.num_faces} triangles is left after cleaning")

    return result, {
        "degenerate_faces": degenerate,
        "duplicate_faces": duplicate,
        "non_manifold_faces": merged.num_faces - manifold.num_faces,
        "small_components": small,
        "small_component_faces": small_faces,
        "decimated_faces": large_parts.num_faces - decimated.num_faces,
    }


def concatenate_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one, side by side: nothing is stitched."""
    starts = np.cumsum([0, *(mesh.num_vertices for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]).astype(np.int32),
        np.concatenate([mesh.colors for mesh in meshes]),
    )


def mesh_of_open3d(surface: Any) -> Mesh:
    """A mesh of Open3D that has colours, as ours."""
    colors = np.clip(np.round(np.asarray(surface.vertex_colors) * 255), 0, 255).astype(np.uint8)
    return Mesh(np.asarray(surface.vertices, np.float32), np.asarray(surface.triangles, np.int32), colors)


def _merge_vertices(mesh: Mesh) -> Mesh:
    """Vertices at exactly the same place become one, the first; its colour stays."""
    order = np.lexsort(mesh.vertices.T)
    ordered = mesh.vertices[order]
    is_new = np.concatenate([[True], np.any(ordered[1:] != ordered[:-1], axis=1)])[: len(order)]
    # lexsort is stable, so that a run begins with its first vertex.
    same_as = np.empty(len(order), np.int32)
    same_as[order] = order[is_new][np.cumsum(is_new) - 1]
    return replace(mesh, faces=same_as[mesh.faces])


def _distinct_faces(mesh: Mesh) -> tuple[Mesh, int, int]:
    """Without faces that have no area or repeat another's corners, and how many of each there were."""
    sorted_faces = np.sort(mesh.faces, axis=1)
    repeats_corner = np.any(sorted_faces[:, 1:] == sorted_faces[:, :-1], axis=1)
    has_area = np.any(face_area_vectors(mesh) != 0, axis=1) & ~repeats_corner
    solid = mesh.faces[has_area]
    first = np.sort(np.unique(sorted_faces[has_area], axis=0, return_index=True)[1])
    return replace(mesh, faces=solid[first]), mesh.num_faces - len(solid), len(solid) - len(first)


def _manifold(mesh: Mesh) -> Mesh:
    """At every edge of more than two triangles, only the largest stays of those that run along it in one direction."""
    edges = edge_table(mesh.faces)
    crowded = (edges.faces > 2)[edges.of_face]
    if not crowded.any():
        return mesh
    starts, ends = mesh.faces, np.roll(mesh.faces, -1, axis=1)
    keys = 2 * edges.of_face + (starts < ends)
    areas = np.broadcast_to(np.linalg.norm(face_area_vectors(mesh), axis=1)[:, None], keys.shape)
    by_area = np.argsort(-areas, axis=None, kind="stable")
    largest = np.zeros(keys.size, bool)
    largest[by_area[np.unique(keys.ravel()[by_area], return_index=True)[1]]] = True
    is_kept = np.all(largest.reshape(-1, 3) | ~crowded, axis=1)
    return replace(mesh, faces=mesh.faces[is_kept])


def _large_components(mesh: Mesh, min_share: float) -> tuple[Mesh, int, int]:
    """The components of at least this share of the largest's faces; how many went, with how many faces."""
    if not mesh.num_faces:
        return mesh, 0, 0
    labels, sizes = face_components(mesh.faces, edge_table(mesh.faces))
    small = sizes < min_share * sizes.max()
    faces = mesh.faces[~small[labels]]
    return replace(mesh, faces=faces), int(small.sum()), mesh.num_faces - len(faces)


def _decimate(mesh: Mesh, max_faces: int | None) -> Mesh:
    """At most `max_faces` triangles by quadric error, colours carried along."""
    if max_faces is None or mesh.num_faces <= max_faces:
        return mesh
    o3d = require("open3d")
    surface = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices.astype(np.float64)), o3d.utility.Vector3iVector(mesh.faces)
    )
    surface.vertex_colors = o3d.utility.Vector3dVector(mesh.colors / 255.0)
    surface.remove_unreferenced_vertices()
    fewer = surface.simplify_quadric_decimation(max_faces)
    return _manifold(_distinct_faces(mesh_of_open3d(fewer))[0])


def _without_unused_vertices(mesh: Mesh) -> Mesh:
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return Mesh(mesh.vertices[used], faces.reshape(-1, 3).astype(np.int32), mesh.colors[used])
