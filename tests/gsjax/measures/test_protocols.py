"""DTU and Tanks and Temples on sets so small that the answer is known by hand."""

import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.measures import protocols as protocols
from gsjax.measures.protocols import CropVolume, ObservationMask
from gsjax.mesh import Mesh

UP = np.array([0.0, 0, 1, 10])  # All of z > -10 lies above the ground.


def plane(height, side=10.0, step=0.25):
    x, y = np.meshgrid(np.arange(0, side, step), np.arange(0, side, step))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], axis=1)


def mask(shape=(20, 20, 20)):
    """Everything in 0..20 mm but the half x >= 10."""
    inside = np.ones(shape, bool)
    inside[10:] = False
    return ObservationMask(inside, low=np.zeros(3), high=np.full(3, 20.0), voxel=1.0)


def test_two_planes_are_as_far_apart_as_they_are():
    found = protocols.dtu(plane(0.5), plane(0.0), mask(), UP)
    assert found == pytest.approx({"accuracy": 0.5, "completeness": 0.5, "overall": 0.5})


def test_points_off_the_mask_do_not_count_for_accuracy_but_do_for_completeness():
    ours = np.concatenate([plane(0.5), plane(3.0) + [10.0, 0, 0]])  # The far half lies where nothing was observed.
    truth = np.concatenate([plane(0.0), plane(0.0) + [10.0, 0, 0]])
    found = protocols.dtu(ours, truth, mask(), UP)
    assert found["accuracy"] == pytest.approx(0.5)
    # Some true points of the far half are nearer to the near plane's edge than to the 3 mm above.
    distances = np.linalg.norm(truth[:, None] - ours[None], axis=-1).min(axis=1)
    assert distances.max() == pytest.approx(3.0)
    assert found["completeness"] == pytest.approx(distances.mean())


def test_outliers_are_left_out_not_capped():
    ours = np.concatenate([plane(0.5), [[5.0, 5.0, 21.4]]])
    watching = ObservationMask(np.ones((40, 40, 40), bool), np.zeros(3), np.full(3, 40.0), 1.0)
    assert protocols.dtu(ours, plane(0.0), watching, UP)["accuracy"] == pytest.approx(0.5)
    near = np.concatenate([plane(0.5), [[5.0, 5.0, 19.0]]])
    count = len(plane(0.5))
    expected = (0.5 * count + 19.0) / (count + 1)
    assert protocols.dtu(near, plane(0.0), watching, UP)["accuracy"] == pytest.approx(expected)


def test_the_ground_below_the_plane_does_not_count():
    truth = np.concatenate([plane(0.0), plane(-15.0)])
    assert protocols.dtu(plane(0.5), truth, mask(), UP)["completeness"] == pytest.approx(0.5)


def test_what_is_far_from_the_box_is_no_data():
    ours = np.concatenate([plane(0.5), [[0.0, 0, -61.0], [0, 0, 141.0]]])
    assert mask().is_near(ours[-2:]).tolist() == [False, False]
    assert mask().is_near(np.array([[0.0, 0, -60.0], [0, 0, 139.9]])).all()
    assert protocols.dtu(ours, plane(0.0), mask(), UP)["accuracy"] == pytest.approx(0.5)


def test_nothing_near_the_scan_is_one_line():
    with pytest.raises(InputError, match="none of the .* reconstructed points in the mask lies within 20.0 mm"):
        protocols.dtu(plane(0.5), plane(0.0) + [0, 0, 100], mask(), np.array([0, 0, 1.0, 0]))
    with pytest.raises(InputError, match="cannot compare 0 points"):
        protocols.dtu(plane(500.0), plane(0.0), mask(), UP)


def test_thinned_points_keep_their_distance_and_cover_the_rest():
    points = np.random.default_rng(0).uniform(0, 1, (3000, 3))
    kept = protocols.thin_points(points, 0.1, seed=1)
    apart = np.linalg.norm(kept[:, None] - kept[None], axis=-1)
    assert apart[~np.eye(len(kept), dtype=bool)].min() > 0.1
    assert np.linalg.norm(points[:, None] - kept[None], axis=-1).min(axis=1).max() <= 0.1


CROP = CropVolume(axis=2, low=-1.0, high=1.0, polygon=np.array([[0, 0, 9], [10, 0, 9], [10, 10, 9], [0, 10, 9.0]]))


def test_a_scan_within_tau_scores_and_one_beyond_does_not():
    same = np.eye(4)
    close = protocols.tanks_and_temples(plane(0.05), plane(0.0), 0.1, crop=CROP, to_truth=same)
    assert (close["precision"], close["recall"], close["fscore"]) == (1, 1, 1)
    far = protocols.tanks_and_temples(plane(0.15), plane(0.0), 0.1, crop=CROP, to_truth=same)
    assert (far["precision"], far["recall"], far["fscore"]) == (0, 0, 0)


def test_half_a_scan_is_precise_and_half_complete():
    half = plane(0.0)
    half = half[half[:, 0] < 5]
    found = protocols.tanks_and_temples(half, plane(0.0), 0.1, crop=CROP, to_truth=np.eye(4))
    assert found["precision"] == 1
    assert found["recall"] == pytest.approx(0.5)
    assert found["fscore"] == pytest.approx(2 / 3)


def test_the_registration_is_applied_before_the_crop():
    to_truth = np.eye(4)
    to_truth[:3, :3] *= 2
    to_truth[:3, 3] = [1.0, 2.0, 0.5]
    ours = (plane(0.0) - to_truth[:3, 3]) / 2
    found = protocols.tanks_and_temples(ours, plane(0.0), 0.1, crop=CROP, to_truth=to_truth)
    assert found["fscore"] == 1
    nothing = protocols.tanks_and_temples(ours + 100, plane(0.0), 0.1, crop=CROP, to_truth=to_truth)
    assert nothing["fscore"] == 0


def test_a_crop_volume_may_be_concave_and_ends_along_its_axis():
    notched = CropVolume(
        axis=1, low=0.0, high=1.0, polygon=np.array([[0, 7, 0], [4, 7, 0], [4, 7, 4], [2, 7, 1], [0, 7, 4.0]])
    )
    points = np.array([[1, 0.5, 1], [2, 0.5, 2], [2, 0.5, 0.5], [3.5, 0.5, 3], [1, 1.5, 1], [1, -0.1, 1], [5, 0.5, 1]])
    assert notched.contains(points).tolist() == [True, False, True, True, False, False, False]


def test_voxel_means_are_means_of_what_shares_a_voxel():
    points = np.array([[0.0, 0, 0], [0.04, 0, 0], [1.0, 0, 0]])
    means = protocols.voxel_means(points, 0.1)
    np.testing.assert_allclose(means[np.argsort(means[:, 0])], [[0.02, 0, 0], [1.0, 0, 0]])
    assert protocols.voxel_means(np.zeros((0, 3)), 0.1).shape == (0, 3)


def test_dense_points_lie_on_the_mesh_and_leave_no_gap():
    mesh = Mesh(np.float32([[0, 0, 0], [4, 0, 0], [0, 3, 0]]), np.int32([[0, 1, 2]]), np.zeros((3, 3), np.uint8))
    points = protocols.dense_points(mesh, 0.2)
    assert len(points) == 3 + round(protocols.DENSER * 6 / 0.04)
    inside = np.array([[0.5, 0.5, 0], [2.0, 1.0, 0], [0.1, 2.7, 0]])
    assert np.linalg.norm(points[:, None] - inside[None], axis=-1).min(axis=0).max() < 0.2
    both = protocols.vertices_and_centers(mesh)
    np.testing.assert_allclose(both, [[0, 0, 0], [4, 0, 0], [0, 3, 0], [4 / 3, 1, 0]], atol=1e-6)


def test_thresholds_are_the_benchmarks_own():
    assert protocols.TANKS_AND_TEMPLES_TAU["Ignatius"] == 0.003
    assert protocols.TANKS_AND_TEMPLES_TAU["Courthouse"] == 0.025
    assert len(protocols.TANKS_AND_TEMPLES_TAU) == 7
