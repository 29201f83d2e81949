"""A triangle mesh with vertex colours, as a plain record of numpy arrays, and its normals."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int32, UInt8


@dataclass(frozen=True)
class Mesh:
    """V vertices and F triangles in world coordinates."""

    vertices: Float[np.ndarray, "V 3"]  # float32 world positions, scene units; float64 in files that are far off
    faces: Int32[np.ndarray, "F 3"]  # vertex indices, counter-clockwise seen from outside
    colors: UInt8[np.ndarray, "V 3"]  # sRGB

    @property
    def num_vertices(self) -> int:
        """Number of vertices."""
        return self.vertices.shape[0]

    @property
    def num_faces(self) -> int:
        """Number of triangles."""
        return self.faces.shape[0]


def face_area_vectors(mesh: Mesh) -> np.ndarray:
    """`[F, 3]` float64 outward normals whose length is the triangle's area, scene units squared."""
    a, b, c = np.moveaxis(mesh.vertices.astype(np.float64)[mesh.faces], 1, 0)
    return 0.5 * np.cross(b - a, c - a)


def face_normals(mesh: Mesh) -> np.ndarray:
    """`[F, 3]` float64 unit outward normals; zero for a triangle without area."""
    return unit_or_zero(face_area_vectors(mesh))


def vertex_normals(mesh: Mesh) -> np.ndarray:
    """`[V, 3]` float64 unit normals, the area-weighted mean over the triangles around; zero where there is none."""
    areas = face_area_vectors(mesh)
    total = np.zeros((mesh.num_vertices, 3))
    for corner in range(3):
        np.add.at(total, mesh.faces[:, corner], areas)
    return unit_or_zero(total)


def signed_volume(mesh: Mesh) -> float:
    """Volume enclosed by a closed mesh, scene units cubed; negative where the faces look inwards."""
    a, b, c = np.moveaxis(mesh.vertices.astype(np.float64)[mesh.faces], 1, 0)
    return float(np.sum(a * np.cross(b, c)) / 6)


def unit_or_zero(vectors: np.ndarray) -> np.ndarray:
    """`[..., 3]` vectors scaled to length 1; a zero vector stays zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(lengths > 0, lengths, 1)


def canonical_order(mesh: Mesh) -> Mesh:
    """Return the mesh in an order that depends on its surface alone.

    Vertices are sorted by position, then by colour; equal ones are one. The first corner of a face has the smallest
    index, and faces are sorted. A face that is left with two equal corners is gone.
    """
    rows = np.concatenate([mesh.vertices, mesh.colors.astype(mesh.vertices.dtype)], axis=1)
    unique, number = np.unique(rows, axis=0, return_inverse=True)
    faces = number.reshape(-1)[mesh.faces]
    turned = faces[:, [[0, 1, 2], [1, 2, 0], [2, 0, 1]]]
    faces = turned[np.arange(len(faces)), np.argmin(faces, axis=1)]
    has_area = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = np.unique(faces[has_area], axis=0)
    return Mesh(unique[:, :3], faces.astype(np.int32), unique[:, 3:].astype(np.uint8))
