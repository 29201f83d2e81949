"""Triangles are halved where there is most to show on them, until there are as many as wanted."""

import numpy as np

from gsjax.meshing.connectivity import EdgeTable, edge_table
from gsjax.scene.meshes import Mesh

NEAR_LARGEST = 0.5  # Triangles of this share of the largest weight and more are halved in one round.


def bisect_triangles(mesh: Mesh, weights: np.ndarray, count: int) -> Mesh:
    """Halve the heaviest triangles at their longest edges, and again, until there are `count`.

    A triangle's halves have half of its weight each. The surface stays where it is, and without cracks: a neighbour
    whose longest edge is the same is halved with it, one that has a longer edge before it (Rivara 1984).

    Args:
        mesh: Whose edges have two triangles at most.
        weights: `[F]` what there is to show on each, such as the pixels that see it; 0 or more.
        count: Most triangles. One or none is missing where there is any weight.

    Returns:
        The mesh; old vertices keep their places in the list, new ones are means of two and follow.
    """
    vertices, colors = mesh.vertices.astype(np.float64), mesh.colors.astype(np.float64)
    faces, weights = mesh.faces.astype(np.int64), np.asarray(weights, np.float64)
    while (room := (count - len(faces)) // 2) > 0 and weights.max(initial=0) > 0:
        heavy = np.argsort(-weights, kind="stable")[:room]
        heavy = heavy[weights[heavy] >= NEAR_LARGEST * weights.max()]
        edges = edge_table(faces)
        lengths = np.linalg.norm(vertices[edges.pairs[:, 0]] - vertices[edges.pairs[:, 1]], axis=1)
        rank = np.empty(len(lengths), np.int64)
        rank[np.argsort(lengths, kind="stable")] = np.arange(len(lengths))
        longest = edges.of_face[np.arange(len(faces)), rank[edges.of_face].argmax(axis=1)]
        both = _faces_of_edges(edges)
        split = np.unique(_terminal(heavy, longest, both))
        middles = len(vertices) + np.arange(len(split))
        ends = edges.pairs[split]
        vertices = np.concatenate([vertices, vertices[ends].mean(axis=1)])
        colors = np.concatenate([colors, colors[ends].mean(axis=1)])
        faces, weights = _halved(faces, weights, both[split], ends, middles)
    return Mesh(vertices.astype(np.float32), faces.astype(np.int32), np.round(colors).astype(np.uint8))


def _faces_of_edges(edges: EdgeTable) -> np.ndarray:
    """`[E, 2]` the triangles at each edge; the second is -1 at a border."""
    owners = np.argsort(edges.of_face, axis=None, kind="stable") // 3
    last = np.cumsum(edges.faces) - 1
    return np.stack([owners[last + 1 - edges.faces], np.where(edges.faces > 1, owners[last], -1)], axis=1)


def _terminal(faces: np.ndarray, longest: np.ndarray, both: np.ndarray) -> np.ndarray:
    """Edges, one a face, that are the longest of all triangles at them: from neighbour to neighbour edges grow."""
    while True:
        edge = longest[faces]
        other = np.where(both[edge, 0] == faces, both[edge, 1], both[edge, 0])
        goes_on = (other >= 0) & (longest[other] != edge)
        if not goes_on.any():
            return edge
        faces = np.where(goes_on, other, faces)


def _halved(
    faces: np.ndarray, weights: np.ndarray, both: np.ndarray, ends: np.ndarray, middles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Every face at an edge becomes two: one takes its place in the list, the other follows at the end."""
    faces, weights = faces.copy(), weights.copy()
    added, shares = [], []
    for side in (0, 1):
        there = both[:, side] >= 0
        ids, (a, b), middle = both[there, side], ends[there].T, middles[there]
        corners = faces[ids]
        added.append(np.where(corners == a[:, None], middle[:, None], corners))
        faces[ids] = np.where(corners == b[:, None], middle[:, None], corners)
        weights[ids] /= 2
        shares.append(weights[ids])
    return np.concatenate([faces, *added]), np.concatenate([weights, *shares])
