import numpy as np
import pytest
from meshes import mesh_of, turned

from gsjax.errors import InputError
from gsjax.meshing.cleaning import concatenate_meshes
from gsjax.meshing.ray_queries import closest_on_mesh
from gsjax.metrics import geometry


def box(size=(1.0, 1.0, 1.0), center=(0.0, 0.0, 0.0)):
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return mesh_of(corners * size + center, [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])


def test_samples_lie_on_the_surface_evenly_by_area():
    mesh = box((1.0, 1.0, 4.0))
    points, normals = geometry.sample_surface(mesh, 20_000, seed=0)
    from_face = np.abs(np.abs(points) - [0.5, 0.5, 2.0]).min(axis=1)
    assert from_face.max() < 1e-6
    # Two of the six sides have 1/18 of the area each.
    assert np.mean(np.abs(normals[:, 2]) > 0.5) == pytest.approx(2 / 18, abs=0.01)
    assert np.all(np.sum(normals * points, -1) > 0)
    assert np.abs(points.mean(0)).max() < 0.05
    np.testing.assert_array_equal(geometry.sample_surface(mesh, 20_000, seed=0)[0], points)


def test_a_mesh_is_near_its_own_samples_and_a_grown_box_is_off_by_what_it_grew():
    truth, normals = geometry.sample_surface(box(), 20_000, seed=1)
    scores = geometry.compare_to_truth(box(), truth, normals, samples=20_000)
    assert scores["threshold"] == pytest.approx(0.01 * np.sqrt(3), rel=1e-3)
    # Nearest neighbours of a random pattern: a share exp(-pi r^2 density) has none within r.
    assert scores["fscore"] == pytest.approx(1 - np.exp(-np.pi * scores["threshold"] ** 2 * 20_000 / 6), abs=0.01)
    assert tuple(scores) == geometry.SCORES
    assert scores["chamfer"] < 0.01  # The mean gap of samples at that density.
    assert scores["chamfer"] == pytest.approx((scores["accuracy"] + scores["completeness"]) / 2)
    assert scores["normal_consistency"] > 0.98  # Beside an edge the nearest sample may lie round the corner.
    grown = geometry.compare_to_truth(box((1.1, 1.1, 1.1)), truth, normals, threshold=0.2)
    assert grown["chamfer"] == pytest.approx(0.05, rel=0.15) and grown["fscore"] == 1.0


def test_surface_where_the_truth_has_no_samples_does_not_count():
    truth, normals = geometry.sample_surface(box(), 5_000, seed=1)
    both = concatenate_meshes([box(), box((3.0, 3.0, 3.0), (20.0, 0.0, 0.0))])
    expected = geometry.compare_to_truth(box(), truth, normals, samples=5_000)
    assert geometry.compare_to_truth(both, truth, normals, samples=5_000) == expected


def test_a_mesh_away_from_the_truth_is_refused():
    truth, normals = geometry.sample_surface(box(), 500, seed=1)
    with pytest.raises(InputError, match="no surface of the mesh"):
        geometry.compare_to_truth(box(center=(20.0, 0.0, 0.0)), truth, normals)
    with pytest.raises(InputError, match="0 points"):
        geometry.nearest(np.zeros((0, 3)), truth)
    flat = mesh_of(np.zeros((3, 3)), [[0, 1, 2]])
    with pytest.raises(InputError, match="without area"):
        geometry.sample_surface(flat, 10, seed=0)


def seen_of_box(count=5_000):
    """Samples of the unit box but its underside, and their normals."""
    points, normals = geometry.sample_surface(box(), count, seed=1)
    is_visible = normals[:, 2] > -0.5
    return points[is_visible], normals[is_visible]


def test_the_true_surface_scores_zero_however_few_its_points():
    scores = geometry.compare_to_surface(box(), box(), *seen_of_box(500), closest_on_mesh, samples=5_000)
    assert scores["chamfer"] < 1e-7
    assert {scores[f"fscore{share}"] for share in ("", "_quarter", "_half", "_double")} == {1.0}
    # On an edge either of its two triangles may be nearest; both have the same samples, of one face each.
    assert scores["normal_consistency"] == pytest.approx(1.0, abs=1e-6)
    assert scores["outward_share"] == 1.0
    assert scores["threshold"] == pytest.approx(0.01 * np.sqrt(3), rel=0.01)


def test_from_point_to_surface_a_grown_box_is_off_by_what_it_grew():
    grown = box((1.1, 1.1, 1.1))
    scores = geometry.compare_to_surface(grown, box(), *seen_of_box(), closest_on_mesh, threshold=0.06)
    assert scores["completeness"] == pytest.approx(0.05, abs=1e-6)
    # Of a side of 1.1, the middle 1.0 lies straight above the box; round it, edges are up to 0.05 further aside. Of the
    # underside, only that rim is near what was seen.
    x = np.maximum(np.abs(np.linspace(-0.55, 0.55, 1101)) - 0.5, 0)
    assert scores["accuracy"] == pytest.approx(np.sqrt(x[:, None] ** 2 + x**2 + 0.05**2).mean(), rel=5e-3)
    assert (scores["recall"], scores["fscore_double"]) == (1.0, 1.0)
    assert (scores["fscore_quarter"], scores["fscore_half"]) == (0.0, 0.0)  # nothing is within 0.03
    assert scores["normal_consistency"] > 0.9  # Of a sample outside an edge, either side of the box is nearest.


def test_what_is_nearest_to_a_side_that_no_camera_saw_does_not_count():
    alone = box()
    under = box((0.8, 0.8, 0.01), (0.0, 0.0, -0.45))  # Within the box, 0.05 above its underside.
    inside = box((0.5, 0.5, 0.01), (0.0, 0.0, 0.4))  # As much, 0.1 below its upper side: wrong.
    far = box((3.0, 3.0, 3.0), (20.0, 0.0, 0.0))
    expected, same, wrong = (
        geometry.compare_to_surface(mesh, box(), *seen_of_box(), closest_on_mesh, samples=40_000)
        for mesh in (alone, concatenate_meshes([alone, under, far]), concatenate_meshes([alone, inside]))
    )
    assert expected["accuracy"] < 1e-7
    assert same["accuracy"] < 1e-7 and same["precision"] == 1.0
    share = 0.52 / 6.52  # Of the area, with its sides of 0.01; an underside that is not seen makes it 0.52 / 5.52.
    assert wrong["accuracy"] == pytest.approx(0.1 * share * 6.52 / 5.52, rel=0.05)
    assert wrong["completeness"] < 1e-7
    with pytest.raises(InputError, match=r"no surface of the mesh \(12 faces\) is where cameras saw"):
        geometry.compare_to_surface(under, box(), *seen_of_box(), closest_on_mesh, samples=1_000)


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
    error = geometry.normal_error_degrees(rendered, true, mask)
    assert error["count"] == 4
    assert error["mean"] == pytest.approx((0 + np.degrees(0.5) + 180 + 90) / 4)
    assert error["median"] == pytest.approx((np.degrees(0.5) + 90) / 2)
    tiny = geometry.normal_error_degrees(np.array([[[1e-6, 0.0, 1.0]]]), true[:1, :1], mask[:1, :1])
    assert tiny["mean"] == pytest.approx(np.degrees(1e-6), rel=1e-6)
    nothing = geometry.normal_error_degrees(rendered, true, np.zeros_like(mask))
    assert nothing["count"] == 0 and np.isnan(nothing["mean"])


def test_a_surface_that_is_inside_out_is_as_near_and_as_steep_but_not_outward():
    truth_samples = geometry.sample_surface(box(), 5_000, seed=1)
    for right, wrong in (
        [geometry.compare_to_surface(mesh, box(), *truth_samples, closest_on_mesh) for mesh in (box(), turned(box()))],
        [geometry.compare_to_truth(mesh, *truth_samples) for mesh in (box(), turned(box()))],
    ):
        assert right["outward_share"] > 0.97 and wrong["outward_share"] < 0.03
        assert wrong["normal_consistency"] == pytest.approx(right["normal_consistency"], abs=0.01)
