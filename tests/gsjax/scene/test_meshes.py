"""The order of a mesh: its surface alone decides it."""

import numpy as np
import pytest

from gsjax.scene.meshes import Mesh, canonical_order, face_area_vectors


@pytest.fixture
def grid(rng):
    """Bumps on a grid of 12 by 12 vertices."""
    x, y = np.meshgrid(np.arange(12), np.arange(12))
    vertices = np.stack([x, y, rng.normal(size=x.shape)], -1).reshape(-1, 3).astype(np.float32)
    corner = (12 * np.arange(11)[:, None] + np.arange(11)).reshape(-1, 1)
    faces = np.concatenate([corner + [0, 1, 13], corner + [0, 13, 12]]).astype(np.int32)
    return Mesh(vertices, faces, rng.integers(0, 256, (144, 3)).astype(np.uint8))


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def shuffled(mesh, rng):
    """The same surface: vertices and faces in another order, every face turned."""
    order, of_faces = rng.permutation(mesh.num_vertices), rng.permutation(mesh.num_faces)
    faces = np.argsort(order)[mesh.faces][of_faces]
    turned = np.take_along_axis(faces, (np.arange(3) + rng.integers(0, 3, (len(faces), 1))) % 3, axis=1)
    return Mesh(mesh.vertices[order], turned.astype(np.int32), mesh.colors[order])


def same(a, b):
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("vertices", "faces", "colors"))


def test_the_order_is_that_of_the_surface(grid, rng):
    first = canonical_order(grid)
    assert all(same(canonical_order(shuffled(grid, rng)), first) for _ in range(5))


def test_faces_keep_their_sides_and_vertices_their_colors(grid):
    def areas(mesh):
        return np.unique(np.round(np.hstack([face_area_vectors(mesh), mesh.colors[mesh.faces].mean(1)]), 4), axis=0)

    np.testing.assert_array_equal(areas(canonical_order(grid)), areas(grid))


def test_equal_vertices_are_one_unless_their_colors_differ():
    vertices = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 0, 0]])
    colors = np.uint8([[1, 1, 1], [2, 2, 2], [3, 3, 3], [2, 2, 2], [9, 9, 9]])
    mesh = canonical_order(Mesh(vertices, np.int32([[0, 1, 2], [1, 3, 2], [0, 4, 2]]), colors))
    assert mesh.num_vertices == 4 and mesh.num_faces == 2


def test_a_mesh_of_nothing_stays_one():
    none = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8))
    assert same(canonical_order(none), none)
