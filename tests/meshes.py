"""Meshes of a known form: a tetrahedron, a square of cells, a ball."""

import numpy as np
import trimesh

from gsjax.scene.meshes import Mesh

GREY = (90, 90, 90)


def mesh_of(vertices, faces, color=GREY) -> Mesh:
    """A mesh of anything array-like, of one colour or a colour a vertex."""
    vertices = np.asarray(vertices, np.float32)
    colors = np.broadcast_to(np.asarray(color, np.uint8), vertices.shape)
    return Mesh(vertices, np.asarray(faces, np.int32), np.ascontiguousarray(colors))


def tetrahedron(offset=(0.0, 0.0, 0.0)) -> Mesh:
    """The corner of a unit cube; its faces look outwards."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) + offset
    return mesh_of(vertices, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def square(count, low=0.0, high=None, *, height=0.0, without=(), color=GREY) -> Mesh:
    """`count` by `count` cells of two triangles that face +z, from `low` to `high` along x and y; some left out.

    `high` is by default such that a cell has side 1; `height` is of all vertices, or `[count + 1, count + 1]`.
    """
    line = np.linspace(low, low + count if high is None else high, count + 1)
    x, y = np.meshgrid(line, line)
    vertices = np.stack([x, y, np.broadcast_to(height, x.shape)], axis=-1).reshape(-1, 3)
    cells = [(i, j) for j in range(count) for i in range(count) if (i, j) not in without]
    corner = np.array([j * (count + 1) + i for i, j in cells])
    above = corner + count + 1
    faces = np.r_[np.stack([corner, corner + 1, above], -1), np.stack([corner + 1, above + 1, above], -1)]
    return mesh_of(vertices, faces, color)


def turned(mesh: Mesh) -> Mesh:
    """The mesh with its faces turned about."""
    return Mesh(mesh.vertices, np.ascontiguousarray(mesh.faces[:, ::-1]), mesh.colors)


def ball(subdivisions=3, radius=1.0, center=(0.0, 0.0, 0.0)) -> Mesh:
    """A sphere of triangles."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return mesh_of(sphere.vertices + np.asarray(center), sphere.faces)
