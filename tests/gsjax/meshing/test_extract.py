import json

import numpy as np
import pytest

from gsjax import geometry
from gsjax.errors import InputError
from gsjax.mesh import face_normals, signed_volume
from gsjax.meshing import depth_of_mesh, extract_mesh
from gsjax.meshing.extract import robust_bounds


@pytest.fixture(scope="module")
def ball_mesh(ball):
    return extract_mesh(ball.gaussians, *ball.views, num_points=12_000)


def test_ball_becomes_one_closed_outward_sphere(ball_mesh):
    mesh, report = ball_mesh
    cleaning = report["cleaning"]
    assert cleaning["components"] == 1
    assert cleaning["watertight"]
    assert cleaning["oriented"]
    assert not cleaning["inside_out"]
    assert signed_volume(mesh) == pytest.approx(4 / 3 * np.pi, rel=0.05)
    radii = np.linalg.norm(mesh.vertices, axis=1)
    assert np.abs(radii - 1).max() < 0.05
    outward = mesh.vertices[mesh.faces].mean(axis=1)
    assert np.mean(np.sum(face_normals(mesh) * outward, axis=-1) > 0.8) > 0.99


def test_chamfer_to_the_sphere_is_small(ball_mesh):
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(40_000, 3))
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    found = geometry.compare_to_truth(ball_mesh[0], truth, truth, samples=40_000)
    # About 0.009 of it is the gap between samples; the level lies about 0.005 above the discs.
    assert found["chamfer"] < 0.02
    assert found["fscore"] > 0.98
    assert found["normal_consistency"] > 0.98


def test_colors_come_from_the_images(ball_mesh):
    assert np.abs(ball_mesh[0].colors.astype(int) - [255, 128, 0]).max() <= 2


def test_report_is_plain_json(ball_mesh):
    report = json.loads(json.dumps(ball_mesh[1]))
    assert report["level_set"]["crossing_share"] > 0.9
    assert report["cleaning"]["faces"] == ball_mesh[0].num_faces
    assert report["points_in_bounds"] <= report["level_set"]["points"] <= 12_000


def test_same_seed_same_mesh(ball, ball_mesh):
    again, _ = extract_mesh(ball.gaussians, *ball.views, num_points=12_000)
    np.testing.assert_array_equal(again.vertices, ball_mesh[0].vertices)
    np.testing.assert_array_equal(again.faces, ball_mesh[0].faces)


def test_ball_on_ground_renders_to_the_depth_it_came_from(ball_on_ground):
    mesh, _ = extract_mesh(ball_on_ground.gaussians, *ball_on_ground.views, num_points=20_000, depth=7)
    camera, depth = ball_on_ground.cameras[0], ball_on_ground.depths[0]
    found = depth_of_mesh(mesh, camera.viewmat, camera.K, camera.width, camera.height)
    both = (found > 0) & (depth > 0)
    assert both.sum() > 0.85 * (depth > 0).sum()
    assert np.median(np.abs(found - depth)[both]) < 0.02


def test_bounds_are_taken_as_they_are(ball):
    mesh, report = extract_mesh(ball.gaussians, *ball.views, num_points=5_000, bounds=((-2, -2, 0), (2, 2, 2)), depth=6)
    assert mesh.vertices[:, 2].min() > -0.2  # The trim lets a few cells over the edge.
    assert mesh.vertices[:, 2].max() == pytest.approx(1, abs=0.05)
    assert not report["cleaning"]["watertight"]
    # Cut at the equator, a little below it.
    assert report["cleaning"]["boundary_length"] == pytest.approx(2 * np.pi, rel=0.35)
    assert report["bounds"] == [[-2, -2, 0], [2, 2, 2]]


@pytest.mark.parametrize(
    ("bounds", "fault"),
    [
        (((5, 5, 5), (6, 6, 6)), "hold none of .* surface points"),
        (((1, 0, 0), (0, 1, 1)), "min below a max"),
        (((0, 0), (1, 1)), "min below a max"),
    ],
)
def test_bounds_with_nothing_in_them_are_one_line(ball, bounds, fault):
    with pytest.raises(InputError, match=fault) as caught:
        extract_mesh(ball.gaussians, *ball.views, num_points=500, bounds=bounds)
    assert "\n" not in str(caught.value)


def test_one_view_gives_the_side_it_sees(ball):
    mesh, report = extract_mesh(ball.gaussians, *(part[:1] for part in ball.views), num_points=2_000)
    eye = -ball.cameras[0].viewmat[:3, :3].T @ ball.cameras[0].viewmat[:3, 3]
    toward = eye / np.linalg.norm(eye)
    assert (mesh.vertices @ toward).min() > -0.2
    assert (mesh.vertices @ toward).max() == pytest.approx(1, abs=0.05)
    assert not report["cleaning"]["watertight"]


def test_robust_bounds_ignore_a_few_strays():
    points = np.random.default_rng(0).uniform(-1, 1, (10_000, 3))
    points[:20] = 1000
    low, high = robust_bounds(points)
    assert np.all(low < -1) and np.all(low > -1.5)
    assert np.all(high > 1) and np.all(high < 1.5)
