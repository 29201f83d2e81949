"""How a mesh hangs together: edges, connected pieces, open borders. Positions play no part but in lengths."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from gsjax.scene.meshes import Mesh, signed_volume


@dataclass(frozen=True)
class EdgeTable:
    """E undirected edges of a mesh."""

    pairs: np.ndarray  # [E, 2] vertex ids, smaller first
    faces: np.ndarray  # [E] triangles on the edge
    same_direction: np.ndarray  # [E] most triangles that run along it in one direction
    of_face: np.ndarray  # [F, 3] edge ids of each triangle


def edge_table(faces: np.ndarray) -> EdgeTable:
    """The edges of `[F, 3]` faces."""
    directed = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    base = int(faces.max(initial=0)) + 1
    # One integer an edge sorts many times faster than a row of two.
    keys, of_face, counts = np.unique(
        directed.min(axis=1) * base + directed.max(axis=1), return_inverse=True, return_counts=True
    )
    forward = np.bincount(of_face, directed[:, 0] < directed[:, 1], minlength=len(keys)).astype(np.int64)
    pairs = np.stack([keys // base, keys % base], axis=1)
    return EdgeTable(pairs, counts, np.maximum(forward, counts - forward), of_face.reshape(-1, 3))


def connected_labels(pairs: np.ndarray, count: int) -> np.ndarray:
    """`[count]` labels of nodes, the same for those that `[P, 2]` pairs connect."""
    graph = coo_matrix((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def face_components(faces: np.ndarray, edges: EdgeTable) -> tuple[np.ndarray, np.ndarray]:
    """`[F]` component id of each face (connected through edges), and `[C]` faces in each component."""
    incidence = np.stack([np.repeat(np.arange(len(faces)), 3), len(faces) + edges.of_face.reshape(-1)], axis=1)
    labels = connected_labels(incidence, len(faces) + len(edges.pairs))[: len(faces)]
    return labels, np.bincount(labels)


def boundary_loops(mesh: Mesh, edges: EdgeTable) -> np.ndarray:
    """`[B]` lengths of the connected runs of open edges, longest first, scene units. Rims that touch count as one."""
    open_edges = edges.pairs[edges.faces == 1]
    if not len(open_edges):
        return np.zeros(0)
    used, ends = np.unique(open_edges, return_inverse=True)
    ends = ends.reshape(-1, 2)
    loop_of = connected_labels(ends, len(used))[ends[:, 0]]
    places = mesh.vertices[open_edges].astype(np.float64)
    return np.sort(np.bincount(loop_of, np.linalg.norm(places[:, 0] - places[:, 1], axis=-1)))[::-1]


def border(mesh: Mesh) -> np.ndarray:
    """`[B, 3]` vertices on open edges: where the mesh ends."""
    edges = edge_table(mesh.faces)
    return mesh.vertices[np.unique(edges.pairs[edges.faces == 1])]


def topology(mesh: Mesh) -> dict[str, int | float | bool]:
    """Pieces, borders and orientation of a mesh with at least one face.

    Returns:
        `components`, connected by edges; `largest_component_share` of the faces; `watertight`, every edge has two
        triangles; `oriented`, neighbours run along their common edge in opposite directions; `inside_out`, watertight
        with a negative volume; `boundary_loops`, connected runs of edges with one triangle: rims of holes, and open
        ends; `boundary_length` of all of them and `largest_hole`, the length of the longest, scene units.
    """
    edges = edge_table(mesh.faces)
    sizes = face_components(mesh.faces, edges)[1]
    loops = boundary_loops(mesh, edges)
    watertight = bool(np.all(edges.faces == 2))
    return {
        "components": len(sizes),
        "largest_component_share": float(sizes.max() / mesh.num_faces),
        "watertight": watertight,
        "oriented": bool(np.all(edges.same_direction < 2)),
        "inside_out": watertight and signed_volume(mesh) < 0,
        "boundary_loops": len(loops),
        "boundary_length": float(loops.sum()),
        "largest_hole": float(loops.max(initial=0)),
    }
