"""Triangles are halved where there is most to show: the surface stays, without cracks, and weights even out."""

import numpy as np
import pytest
from meshes import ball

from gsjax.meshing.bisection import bisect_triangles
from gsjax.meshing.connectivity import topology
from gsjax.meshing.ray_queries import closest_on_mesh
from gsjax.scene.meshes import Mesh, signed_volume


def areas(mesh: Mesh) -> np.ndarray:
    a, b, c = (mesh.vertices.astype(np.float64)[mesh.faces[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def weights_at(mesh: Mesh, place) -> np.ndarray:
    """More, the nearer to a place, and in proportion to the area: a density that halves have half of."""
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    return areas(mesh) * np.exp(-8 * np.sum((middles - place) ** 2, axis=1))


def test_the_surface_stays_where_it_was_with_smaller_triangles_where_weights_are_larger():
    ball_mesh = ball(2)
    place = ball_mesh.vertices[0]
    halved = bisect_triangles(ball_mesh, weights_at(ball_mesh, place), 4 * ball_mesh.num_faces)
    assert 4 * ball_mesh.num_faces - 1 <= halved.num_faces <= 4 * ball_mesh.num_faces
    after, before = topology(halved), topology(ball_mesh)
    assert after == before and after["watertight"] and after["oriented"]
    assert signed_volume(halved) == pytest.approx(signed_volume(ball_mesh), rel=1e-5)
    np.testing.assert_array_equal(halved.vertices[: ball_mesh.num_vertices], ball_mesh.vertices)
    away = np.linalg.norm(halved.vertices - closest_on_mesh(ball_mesh, halved.vertices)[0], axis=1)
    assert away.max() < 1e-6

    distance = np.linalg.norm(halved.vertices[halved.faces].mean(axis=1) - place, axis=1)
    near, far = (np.median(areas(halved)[mask]) for mask in (distance < 0.4, distance > 1.5))
    assert near < far / 8
    # As even as halves allow: by a factor of two, and by neighbours that are halved along.
    assert weights_at(halved, place).max() < 4 * np.sort(weights_at(halved, place))[-halved.num_faces // 3]
