import numpy as np
import pytest
import trimesh

from gsjax.meshing.ray_queries import closest_on_mesh
from gsjax.scene.meshes import Mesh


def soup(count, seed=0, at=0.0):
    """Triangles anywhere in a cube of side 2."""
    corners = np.random.default_rng(seed).uniform(-1, 1, (3 * count, 3)) + at
    return Mesh(corners.astype(np.float32), np.arange(3 * count).reshape(-1, 3), np.zeros((3 * count, 3), np.uint8))


@pytest.mark.parametrize("at", [0.0, 500.0])
def test_distances_are_those_of_a_search_through_all_triangles_in_float64(at):
    mesh, queries = soup(60, at=at), np.random.default_rng(1).uniform(-1.5, 1.5, (300, 3)) + at
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    every = np.stack([trimesh.triangles.closest_point(corners, np.repeat(q[None], len(corners), 0)) for q in queries])
    expected = np.linalg.norm(every - queries[:, None], axis=2)
    points, triangles = closest_on_mesh(mesh, queries)
    distances = np.linalg.norm(points - queries, axis=1)
    assert np.abs(distances - expected.min(axis=1)).max() < 1e-6
    np.testing.assert_allclose(expected[np.arange(300), triangles], expected.min(axis=1), atol=1e-6)


def test_a_triangle_without_area_spoils_nothing():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0], [5, 5, 5]], np.float32)
    mesh = Mesh(corners, np.array([[0, 1, 2], [3, 4, 5], [6, 6, 6]]), np.zeros((7, 3), np.uint8))
    points, triangles = closest_on_mesh(mesh, np.array([[0.2, 0.2, 0.3], [3.5, 0.1, 0.0], [5.0, 5.0, 5.5]]))
    np.testing.assert_allclose(points, [[0.2, 0.2, 0.0], [3.5, 0.0, 0.0], [5.0, 5.0, 5.0]], atol=1e-6)
    assert triangles.tolist() == [0, 1, 2]
