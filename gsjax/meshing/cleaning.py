"""Taking out of a mesh what no later stage should have to expect, and saying what was there."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from gsjax.errors import InputError
from gsjax.mesh import Mesh, face_area_vectors, signed_volume
from gsjax.meshing.libraries import load_open3d


@dataclass(frozen=True)
class CleaningReport:
    """What a cleaned mesh is, and what was taken out of it."""

    vertices: int
    faces: int
    components: int  # pieces connected by edges, after the small ones went
    watertight: bool  # every edge has two triangles
    boundary_length: float  # sum over edges with one triangle, scene units
    oriented: bool  # neighbours run along their common edge in opposite directions
    inside_out: bool  # watertight, and encloses a negative volume
    degenerate_faces: int  # taken out: a corner twice, or no area
    duplicate_faces: int  # taken out: the same three corners again
    non_manifold_faces: int  # taken out: smallest ones at edges of more than two triangles
    small_components: int  # taken out
    small_component_faces: int  # taken out with them
    decimated_faces: int  # saved by decimation


def clean(
    mesh: Mesh, *, min_component_share: float = 0.01, max_faces: int | None = None
) -> tuple[Mesh, CleaningReport]:
    """Merges equal vertices, takes out degenerate, duplicate, non-manifold and stray triangles, then decimates.

    Args:
        mesh: Any mesh.
        min_component_share: Connected pieces with fewer faces than this share of the largest one are taken out.
        max_faces: Above this number of triangles, quadric decimation brings it down. None: never.

    Returns:
        The mesh without unused vertices, and what was done.

    Raises:
        InputError: Nothing is left.
    """
    merged, degenerate, duplicate = _distinct_faces(_merge_vertices(mesh))
    manifold = _manifold(merged)
    kept, small, small_faces = _large_components(manifold, min_component_share)
    decimated = _decimate(kept, max_faces)
    result = _without_unused_vertices(decimated)
    if not result.num_faces:
        raise InputError(f"no mesh: nothing of {mesh.num_faces} triangles is left after cleaning")

    edges = edge_table(result.faces)
    watertight = bool(np.all(edges.faces == 2))
    return result, CleaningReport(
        vertices=result.num_vertices,
        faces=result.num_faces,
        components=int(face_components(result)[1].size),
        watertight=watertight,
        boundary_length=_length(result, edges.pairs[edges.faces == 1]),
        oriented=bool(np.all(edges.same_direction < 2)),
        inside_out=watertight and signed_volume(result) < 0,
        degenerate_faces=degenerate,
        duplicate_faces=duplicate,
        non_manifold_faces=merged.num_faces - manifold.num_faces,
        small_components=small,
        small_component_faces=small_faces,
        decimated_faces=kept.num_faces - decimated.num_faces,
    )


@dataclass(frozen=True)
class EdgeTable:
    """E undirected edges of a mesh."""

    pairs: np.ndarray  # [E, 2] vertex ids, smaller first
    faces: np.ndarray  # [E] triangles on the edge
    same_direction: np.ndarray  # [E] most triangles that run along it in one direction
    of_face: np.ndarray  # [F, 3] edge ids of each triangle


def edge_table(faces: np.ndarray) -> EdgeTable:
    """The edges of `[F, 3]` faces."""
    directed = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    pairs, of_face, counts = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    of_face = of_face.reshape(-1)
    forward = np.bincount(of_face, directed[:, 0] < directed[:, 1], minlength=len(pairs)).astype(np.int64)
    return EdgeTable(pairs, counts, np.maximum(forward, counts - forward), of_face.reshape(-1, 3))


def face_components(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """`[F]` component id of each face (connected through edges), and `[C]` faces in each component."""
    edges = edge_table(mesh.faces)
    face_ids = np.repeat(np.arange(mesh.num_faces), 3)
    incidence = coo_matrix(
        (np.ones(len(face_ids), bool), (face_ids, edges.of_face.reshape(-1))), (mesh.num_faces, len(edges.pairs))
    ).tocsr()
    labels = connected_components(incidence @ incidence.T, directed=False)[1]
    return labels, np.bincount(labels)


def _merge_vertices(mesh: Mesh) -> Mesh:
    """Vertices at exactly the same place become one, the first; its colour stays."""
    _, first, inverse = np.unique(mesh.vertices, axis=0, return_index=True, return_inverse=True)
    return Mesh(mesh.vertices, first[inverse.reshape(-1)][mesh.faces].astype(np.int32), mesh.colors)


def _distinct_faces(mesh: Mesh) -> tuple[Mesh, int, int]:
    """Without faces that have no area or repeat another's corners, and how many of each there were."""
    sorted_faces = np.sort(mesh.faces, axis=1)
    repeats_corner = np.any(sorted_faces[:, 1:] == sorted_faces[:, :-1], axis=1)
    has_area = np.any(face_area_vectors(mesh) != 0, axis=1) & ~repeats_corner
    solid = mesh.faces[has_area]
    first = np.sort(np.unique(sorted_faces[has_area], axis=0, return_index=True)[1])
    return Mesh(mesh.vertices, solid[first], mesh.colors), mesh.num_faces - len(solid), len(solid) - len(first)


def _manifold(mesh: Mesh) -> Mesh:
    """At every edge of more than two triangles, only the two largest stay."""
    edges = edge_table(mesh.faces)
    if not len(edges.faces) or edges.faces.max() <= 2:
        return mesh
    o3d = load_open3d()
    surface = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices.astype(np.float64)), o3d.utility.Vector3iVector(mesh.faces)
    )
    surface.remove_non_manifold_edges()
    return Mesh(mesh.vertices, np.asarray(surface.triangles, np.int32), mesh.colors)


def _large_components(mesh: Mesh, min_share: float) -> tuple[Mesh, int, int]:
    """The components of at least this share of the largest's faces; how many went, with how many faces."""
    if not mesh.num_faces:
        return mesh, 0, 0
    labels, sizes = face_components(mesh)
    small = sizes < min_share * sizes.max()
    faces = mesh.faces[~small[labels]]
    return Mesh(mesh.vertices, faces, mesh.colors), int(small.sum()), mesh.num_faces - len(faces)


def _decimate(mesh: Mesh, max_faces: int | None) -> Mesh:
    """At most `max_faces` triangles by quadric error, colours carried along."""
    if max_faces is None or mesh.num_faces <= max_faces:
        return mesh
    o3d = load_open3d()
    surface = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices.astype(np.float64)), o3d.utility.Vector3iVector(mesh.faces)
    )
    surface.vertex_colors = o3d.utility.Vector3dVector(mesh.colors / 255.0)
    surface.remove_unreferenced_vertices()
    fewer = surface.simplify_quadric_decimation(max_faces)
    colors = np.clip(np.round(np.asarray(fewer.vertex_colors) * 255), 0, 255).astype(np.uint8)
    result = Mesh(np.asarray(fewer.vertices, np.float32), np.asarray(fewer.triangles, np.int32), colors)
    return _manifold(_distinct_faces(result)[0])


def _without_unused_vertices(mesh: Mesh) -> Mesh:
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return Mesh(mesh.vertices[used], faces.reshape(-1, 3).astype(np.int32), mesh.colors[used])


def _length(mesh: Mesh, pairs: np.ndarray) -> float:
    ends = mesh.vertices.astype(np.float64)[pairs]
    return float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=-1).sum())
