import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.measures import geometry
from gsjax.mesh import Mesh, face_normals, signed_volume, vertex_normals


def box(size=(1.0, 1.0, 1.0), center=(0.0, 0.0, 0.0)):
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))], np.int32)
    vertices = (corners * size + center).astype(np.float32)
    return Mesh(vertices, faces, np.full((8, 3), 100, np.uint8))


def square_grid(count, z=0.0):
    x, y = np.meshgrid(np.linspace(0, 1, count), np.linspace(0, 1, count))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=-1)


def test_the_box_of_these_tests_faces_outwards():
    mesh = box((2.0, 3.0, 4.0), (10.0, 0.0, 0.0))
    assert signed_volume(mesh) == pytest.approx(24.0)
    outward = mesh.vertices[mesh.faces].mean(1) - [10, 0, 0]
    assert np.all(np.sum(face_normals(mesh) * outward, -1) > 0)
    cube = box()
    diagonal = cube.vertices / np.linalg.norm(cube.vertices, axis=1, keepdims=True)
    assert np.all(np.sum(vertex_normals(cube) * diagonal, -1) > 0.8)


def test_distances_of_parallel_squares_are_their_gap():
    low, high = square_grid(30), square_grid(30, z=0.25)
    assert geometry.accuracy_completeness(low, high) == pytest.approx((0.25, 0.25))
    assert geometry.chamfer(low, high) == pytest.approx(0.25)
    assert geometry.chamfer(low, low) == 0


def test_accuracy_and_completeness_are_the_two_directions():
    half = np.array([[0.0, 0, 0]])
    both = np.array([[0.0, 0, 0], [3.0, 4.0, 0]])
    assert geometry.accuracy_completeness(half, both) == (0.0, 2.5)
    assert geometry.accuracy_completeness(both, half) == (2.5, 0.0)
    assert geometry.chamfer(half, both) == geometry.chamfer(both, half) == 1.25


def test_chamfer_of_concentric_spheres_is_the_difference_of_the_radii():
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert geometry.chamfer(directions, 1.2 * directions) == pytest.approx(0.2, rel=0.01)


def test_fscore_by_hand():
    predicted = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [9.0, 0, 0]])
    truth = np.array([[0.05, 0, 0], [1.05, 0, 0]])
    # Precision 2/4, recall 2/2.
    assert geometry.fscore(predicted, truth, 0.1) == pytest.approx(2 * 0.5 / 1.5)
    assert geometry.fscore(predicted, truth, 0.01) == 0


def test_normal_consistency_is_the_cosine_and_unsigned():
    points = square_grid(10)
    up, tilted = np.tile([0.0, 0, 1], (100, 1)), np.tile([np.sin(0.3), 0, np.cos(0.3)], (100, 1))
    assert geometry.normal_consistency(points, up, points, tilted) == pytest.approx(np.cos(0.3))
    assert geometry.normal_consistency(points, -up, points, up) == pytest.approx(1.0)


def test_samples_lie_on_the_surface_evenly_by_area():
    mesh = box((1.0, 1.0, 4.0))
    points, normals = geometry.sample_surface(mesh, 20_000, seed=0)
    from_face = np.abs(np.abs(points) - [0.5, 0.5, 2.0]).min(axis=1)
    assert from_face.max() < 1e-6
    # Two of the six sides have 1/18 of the area each.
    assert np.mean(np.abs(normals[:, 2]) > 0.5) == pytest.approx(2 / 18, abs=0.01)
    assert np.all(np.sum(normals * points, -1) > 0)
    assert np.abs(points.mean(0)).max() < 0.05
    again, _ = geometry.sample_surface(mesh, 20_000, seed=0)
    np.testing.assert_array_equal(points, again)


def test_comparing_a_mesh_with_its_own_samples_is_near_perfect():
    truth, normals = geometry.sample_surface(box(), 20_000, seed=1)
    found = geometry.compare_to_truth(box(), truth, normals, samples=20_000)
    assert found["threshold"] == pytest.approx(0.01 * np.sqrt(3), rel=1e-3)
    # Nearest neighbours of a random pattern: a share exp(-pi r^2 density) has none within r.
    assert found["fscore"] == pytest.approx(1 - np.exp(-np.pi * found["threshold"] ** 2 * 20_000 / 6), abs=0.01)
    assert found["chamfer"] < 0.01  # The mean gap of samples at that density.
    assert found["chamfer"] == pytest.approx((found["accuracy"] + found["completeness"]) / 2)
    assert found["normal_consistency"] > 0.98  # Beside an edge the nearest sample may lie round the corner.


def test_a_grown_box_is_off_by_what_it_grew():
    truth, normals = geometry.sample_surface(box(), 20_000, seed=1)
    found = geometry.compare_to_truth(box((1.1, 1.1, 1.1)), truth, normals, threshold=0.2)
    assert found["chamfer"] == pytest.approx(0.05, rel=0.15)
    assert found["fscore"] == 1.0


def test_surface_where_the_truth_has_no_samples_does_not_count():
    truth, normals = geometry.sample_surface(box(), 5_000, seed=1)
    alone = box()
    far = box((3.0, 3.0, 3.0), (20.0, 0.0, 0.0))
    both = Mesh(
        np.concatenate([alone.vertices, far.vertices]),
        np.concatenate([alone.faces, far.faces + 8]),
        np.concatenate([alone.colors, far.colors]),
    )
    expected = geometry.compare_to_truth(alone, truth, normals, samples=5_000)
    assert geometry.compare_to_truth(both, truth, normals, samples=5_000) == expected


def test_a_mesh_away_from_the_truth_is_refused():
    truth, normals = geometry.sample_surface(box(), 500, seed=1)
    with pytest.raises(InputError, match="no surface of the mesh"):
        geometry.compare_to_truth(box(center=(20.0, 0.0, 0.0)), truth, normals)
    with pytest.raises(InputError, match="0 points"):
        geometry.chamfer(np.zeros((0, 3)), truth)
    flat = Mesh(np.zeros((3, 3), np.float32), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8))
    with pytest.raises(InputError, match="without area"):
        geometry.sample_surface(flat, 10, seed=0)


def test_normal_error_of_known_rotations():
    true = np.zeros((2, 3, 3))
    true[..., 2] = 1
    true[1, 2] = 0  # No truth here.
    rendered = true.copy()
    rendered[0, 1] = [np.sin(0.5), 0, np.cos(0.5)]
    rendered[0, 2] = [0, 0, -2]  # Opposite, and not of length 1.
    rendered[1, 0] = 0  # Nothing rendered.
    mask = np.ones((2, 3), bool)
    mask[1, 1] = False
    found = geometry.normal_error_degrees(rendered, true, mask)
    assert found["count"] == 4
    assert found["mean"] == pytest.approx((0 + np.degrees(0.5) + 180 + 90) / 4)
    assert found["median"] == pytest.approx((np.degrees(0.5) + 90) / 2)


def test_tiny_angles_survive():
    true = np.array([[[0.0, 0.0, 1.0]]])
    rendered = np.array([[[1e-6, 0.0, 1.0]]])
    found = geometry.normal_error_degrees(rendered, true, np.ones((1, 1), bool))
    assert found["mean"] == pytest.approx(np.degrees(1e-6), rel=1e-6)


def test_normal_error_over_nothing_is_nan_with_count_zero():
    found = geometry.normal_error_degrees(np.ones((2, 2, 3)), np.ones((2, 2, 3)), np.zeros((2, 2), bool))
    assert found["count"] == 0
    assert np.isnan(found["mean"])
