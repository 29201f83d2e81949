import jax
import jax.numpy as jnp
import numpy as np
import pycolmap
import pytest
from PIL import Image
from record_fields import check_fields
from small_scenes import built_in

import gsjax
from gsjax.analytic import solids
from gsjax.io import analytic_scene
from gsjax.scene.batches import decode

VIEWS, SIZE = 9, (48, 40)  # as other tests have it, so that it is written once a session
SDF = jax.jit(jax.vmap(solids.scene_sdf))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return built_in(tmp_path_factory.mktemp("data") / "scene", num_views=VIEWS, size=SIZE)


@pytest.fixture(scope="module")
def cameras():
    return solids.cameras(VIEWS, SIZE)


def test_depth_normals_and_labels_are_those_of_a_new_trace(folder, cameras):
    view = solids.trace(cameras[3], samples=2)
    depth, normals = np.load(folder / "depth/003.npz"), np.load(folder / "normals/003.npz")
    assert (depth["depth"].dtype, depth["label"].dtype, normals["cam"].dtype) == (np.float32, np.uint8, np.float16)
    np.testing.assert_array_equal(depth["depth"], view.depth)
    np.testing.assert_array_equal(depth["label"], view.labels)
    np.testing.assert_allclose(normals["cam"], view.normals, atol=1e-3)
    rotation = np.asarray(cameras[3].viewmat)[:3, :3]
    np.testing.assert_allclose(normals["world"] @ rotation.T, normals["cam"], atol=3e-3)
    picture = np.asarray(Image.open(folder / "images/003.png"))
    np.testing.assert_allclose(picture / 255, view.colors, atol=0.51 / 255)


def test_the_records_that_are_read_hold_what_their_fields_state(folder):
    scene = gsjax.load_scene(folder)
    frame, truth = scene.frames[0], scene.truth
    view = jax.device_put(gsjax.read_views(scene.train_frames, normals=folder / "normals")[0])
    records = scene, scene.tracks(), frame, frame.pixels(), truth, gsjax.read_mesh(truth.mesh)
    for record in (*records, view, decode(view, jnp.zeros(3, jnp.float32))):
        check_fields(record)


def test_the_model_holds_the_true_cameras_and_consistent_tracks(folder, cameras):
    model = pycolmap.Reconstruction(folder / "sparse/0")
    assert sorted(image.name for image in model.images.values()) == [f"{i:03d}.png" for i in range(VIEWS)]
    assert len(model.cameras) == 1
    for image_id, image in model.images.items():
        camera = cameras[image_id - 1]
        np.testing.assert_allclose(image.cam_from_world().matrix(), camera.viewmat[:3], atol=1e-6)
        K = model.cameras[image.camera_id].calibration_matrix()
        np.testing.assert_allclose(K, camera.K, rtol=1e-6)
    assert 500 < len(model.points3D) <= sum(analytic_scene.SPARSE_POINTS)
    errors = []
    for point in model.points3D.values():
        assert 2 <= point.track.length() <= analytic_scene.LONGEST_TRACK
        for element in point.track.elements:
            image = model.images[element.image_id]
            observed = image.points2D[element.point2D_idx]
            cam = image.cam_from_world().matrix() @ [*point.xyz, 1.0]
            K = model.cameras[1].calibration_matrix()
            errors.append(np.linalg.norm((K @ cam)[:2] / cam[2] - observed.xy))
    # Pixel noise, and point noise seen at focal length / distance.
    expected = np.hypot(analytic_scene.PIXEL_NOISE, analytic_scene.POINT_NOISE * 1.4 * SIZE[0] / 2.95)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(errors)) / 2), expected, rtol=0.1)
    distances = SDF(np.float32([point.xyz for point in model.points3D.values()]))
    np.testing.assert_allclose(np.std(distances), analytic_scene.POINT_NOISE, rtol=0.15)


def test_truth_points_lie_on_the_surface_with_their_normals(folder):
    truth = np.load(folder / "gt_points.npz")
    points, normals = truth["points"], truth["normals"].astype(np.float32)
    assert points.dtype == np.float32
    assert np.abs(SDF(points)).max() < 1e-4
    outside = jax.jit(jax.vmap(solids.normal))(points + solids.BEFORE * normals)  # on a face a gradient may be none
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-3)
    assert np.mean(np.abs(normals - outside).max(axis=1) < 1e-3) > 0.999  # where two parts touch it may be either's
    is_table = np.asarray(jax.jit(jax.vmap(solids.label))(points)) == solids.GROUND_LABEL
    assert np.mean(is_table == truth["label"]) > 0.99  # where both touch either may be named
    assert np.abs(points[truth["label"] == 1, :2]).max() < analytic_scene.TRUTH_HALF
    assert truth["n_train_views"].min() >= analytic_scene.TRUTH_VIEWS
    assert truth["n_train_views"].max() <= VIEWS - 2  # without the held-out views, the first and the last
    assert np.bincount(truth["label"]).tolist() == [6_000, 4_000]
