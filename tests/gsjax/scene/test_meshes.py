"""The order of a mesh: its surface alone decides it."""

import numpy as np
from meshes import square

from gsjax.scene.meshes import Mesh, canonical_order, face_area_vectors

RNG = np.random.default_rng(0)
GRID = square(11, height=RNG.normal(size=(12, 12)), color=RNG.integers(0, 256, (144, 3)))


def shuffled(mesh, rng):
    """The same surface: vertices and faces in another order, every face turned."""
    order, of_faces = rng.permutation(mesh.num_vertices), rng.permutation(mesh.num_faces)
    faces = np.argsort(order)[mesh.faces][of_faces]
    turned = np.take_along_axis(faces, (np.arange(3) + rng.integers(0, 3, (len(faces), 1))) % 3, axis=1)
    return Mesh(mesh.vertices[order], turned.astype(np.int32), mesh.colors[order])


def test_the_order_is_that_of_the_surface():
    first = canonical_order(GRID)
    for seed in range(5):
        again = canonical_order(shuffled(GRID, np.random.default_rng(seed)))
        for name in ("vertices", "faces", "colors"):
            np.testing.assert_array_equal(getattr(again, name), getattr(first, name))


def test_faces_keep_their_sides_and_vertices_their_colors():
    def areas(mesh):
        return np.unique(np.round(np.hstack([face_area_vectors(mesh), mesh.colors[mesh.faces].mean(1)]), 4), axis=0)

    np.testing.assert_array_equal(areas(canonical_order(GRID)), areas(GRID))


def test_equal_vertices_are_one_unless_their_colors_differ():
    vertices = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 0, 0]])
    colors = np.uint8([[1, 1, 1], [2, 2, 2], [3, 3, 3], [2, 2, 2], [9, 9, 9]])
    mesh = canonical_order(Mesh(vertices, np.int32([[0, 1, 2], [1, 3, 2], [0, 4, 2]]), colors))
    assert mesh.num_vertices == 4 and mesh.num_faces == 2
