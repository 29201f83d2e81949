import shutil
import struct

import cv2
import numpy as np
import pycolmap
import pytest

from gsjax.errors import InputError
from gsjax.io.colmap import find_model, read_capture
from gsjax.io.scenes import load_scene


def mean_reprojection_error(scene, model_folder) -> float:
    """Pixels between observations, sent into the frame, and the points projected by the frame's own matrices."""
    model = pycolmap.Reconstruction(model_folder)
    frames = {frame.name: frame for frame in scene.frames}
    errors = []
    for image in model.images.values():
        frame = frames[image.name]
        seen = [p for p in image.points2D if p.has_point3D()]
        world = np.array([model.points3D[p.point3D_id].xyz for p in seen])
        rays = np.asarray(image.camera.cam_from_img(np.array([p.xy for p in seen])))
        observed = rays * frame.K[[0, 1], [0, 1]] + frame.K[:2, 2]
        in_camera = world @ frame.viewmat[:3, :3].T + frame.viewmat[:3, 3]
        projected = in_camera[:, :2] / in_camera[:, 2:] * frame.K[[0, 1], [0, 1]] + frame.K[:2, 2]
        errors.append(np.linalg.norm(observed - projected, axis=1))
    return float(np.concatenate(errors).mean())


@pytest.mark.parametrize(("folder", "documented"), [("fox", 0.223), ("fox/undistorted", 0.2298), ("fern", 0.1766)])
def test_real_models_reproject_as_their_readme_says(shared, folder, documented):
    root = shared / "data" / folder
    scene = load_scene(root)
    # The error of a distorted model is measured here in the undistorted image, a few per cent larger or smaller.
    assert mean_reprojection_error(scene, root / "sparse/0") == pytest.approx(documented, rel=0.03)


@pytest.mark.parametrize("folder", ["fox", "kitchen"])
def test_tracks_are_the_models_observations_without_distortion(shared, folder):
    root = shared / "data" / folder
    scene = load_scene(root)
    tracks, model = scene.tracks(), pycolmap.Reconstruction(root / "sparse/0")
    assert tracks.names == tuple(frame.name for frame in scene.frames)
    assert len(tracks.point) == model.compute_num_observations()
    viewmats = np.stack([frame.viewmat for frame in scene.frames])[tracks.photo]
    local = np.einsum("oij,oj->oi", viewmats[:, :3, :3], scene.points[tracks.point]) + viewmats[:, :3, 3]
    errors = np.linalg.norm(local[:, :2] / local[:, 2:] - tracks.rays, axis=1) * scene.frames[0].K[0, 0]
    per_point = np.bincount(tracks.point, errors) / np.bincount(tracks.point)
    # The model's own error is in distorted pixels; a wrong point or photo would be off by hundreds.
    assert per_point.mean() == pytest.approx(model.compute_mean_reprojection_error(), rel=0.05)


def test_a_model_without_keypoints_has_empty_tracks(colmap_scene):
    tracks = load_scene(colmap_scene()).tracks()
    assert len(tracks.names) == 10
    assert tracks.photo.shape == tracks.point.shape == (0,)
    assert tracks.rays.shape == (0, 2)


def test_our_undistortion_shows_what_colmaps_own_shows(shared):
    ours = load_scene(shared / "data/fox").frames[3]
    theirs = load_scene(shared / "data/fox/undistorted").frames[3]
    np.testing.assert_allclose(ours.viewmat, theirs.viewmat, atol=1e-6)
    shift = theirs.K[:2, 2:] - ours.K[:2, 2:]  # they were cut to slightly different windows

    def difference(extra: float) -> float:
        moved = np.concatenate([np.eye(2), shift + [[extra], [0.0]]], axis=1)
        picture = cv2.warpAffine(ours.pixels().image, moved, (theirs.width, theirs.height))
        return np.abs(picture.astype(int) - theirs.pixels().image)[8:-8, 8:-8].mean()

    assert difference(0.0) < 3.5  # two rounds of JPEG; the distorted photo itself differs by 7
    assert difference(0.0) < 0.6 * min(difference(-1.0), difference(1.0))


def test_binary_and_text_give_the_same_capture(colmap_scene, tmp_path):
    root = colmap_scene()
    model = root / "sparse/0"
    binary = read_capture(root, model)
    pycolmap.Reconstruction(model).write_text(model)
    for file in model.glob("*.bin"):
        file.unlink()
    text = read_capture(root, model)
    np.testing.assert_array_equal(binary.points, text.points)
    np.testing.assert_array_equal(binary.point_colors, text.point_colors)
    for a, b in zip(binary.photos, text.photos, strict=True):
        assert (a.name, a.path, a.lens) == (b.name, b.path, b.lens)
        np.testing.assert_allclose(a.viewmat, b.viewmat, atol=1e-12)
    assert binary.photos[3].viewmat[0, 3] == pytest.approx(0.3)
    assert binary.photos[0].lens.params == (30.0, 31.0, 21.0, 14.5)


@pytest.mark.parametrize("place", ["sparse/0", "sparse", "colmap/sparse/0", "."])
def test_the_model_is_found_in_its_usual_places(colmap_scene, place, tmp_path):
    root = colmap_scene(count=3)
    moved = tmp_path / "moved"
    shutil.copytree(root / "images", moved / "images")
    shutil.copytree(root / "sparse/0", moved / place, dirs_exist_ok=True)
    assert find_model(moved) == moved / place
    assert len(load_scene(moved).frames) == 3


def test_the_model_folder_itself_and_images_beside_the_model_are_found(colmap_scene):
    root = colmap_scene(count=3)
    assert len(load_scene(root / "sparse/0").frames) == 3
    for image in (root / "images").iterdir():
        image.rename(root / image.name)
    assert len(load_scene(root).frames) == 3


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.3, 0.6, 0.95, 0.999])
def test_truncated_files_are_named(colmap_scene, name, share):
    root = colmap_scene(points=30)
    file = root / "sparse/0" / name
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=f"{name}: truncated") as error:
        load_scene(root)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["cameras.txt", "images.txt", "points3D.txt"])
def test_damaged_text_is_one_line(colmap_scene, name):
    root = colmap_scene(text=True)
    file = root / "sparse/0" / name
    file.write_text(file.read_text()[:-12] + "x 1")
    with pytest.raises(InputError, match="sparse/0") as error:
        load_scene(root)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin"])
def test_bytes_gone_wrong_never_escape_as_another_error(colmap_scene, name):
    """Whatever single byte is overwritten, the model loads or the fault is one line."""
    root = colmap_scene(count=3)
    file = root / "sparse/0" / name
    data = file.read_bytes()
    for at in range(0, len(data), max(1, len(data) // 12)):
        file.write_bytes(data[:at] + b"\xff" + data[at + 1 :])
        try:
            load_scene(root)
        except InputError as error:
            assert "\n" not in str(error)


def test_unknown_camera_models_are_named(colmap_scene):
    root = colmap_scene()
    file = root / "sparse/0/cameras.bin"
    data = bytearray(file.read_bytes())
    data[12:16] = struct.pack("<i", 77)
    file.write_bytes(data)
    with pytest.raises(InputError, match="cameras.bin: unknown camera model 77 of camera 1"):
        load_scene(root)


def test_unknown_camera_models_are_named_in_text(colmap_scene):
    root = colmap_scene(text=True)
    file = root / "sparse/0/cameras.txt"
    file.write_text(file.read_text().replace("PINHOLE", "PINHOLA"))
    with pytest.raises(InputError, match="cameras.txt: unknown camera model 'PINHOLA' of camera 1"):
        load_scene(root)


def test_a_part_that_is_missing_is_named(colmap_scene):
    root = colmap_scene()
    (root / "sparse/0/images.bin").unlink()
    with pytest.raises(InputError, match="images.bin: missing"):
        load_scene(root)


def test_a_model_without_points_is_refused(colmap_scene):
    with pytest.raises(InputError, match="has no points"):
        load_scene(colmap_scene(points=0))


@pytest.mark.parametrize("count", [0, 1])
def test_a_single_image_is_refused(colmap_scene, count):
    with pytest.raises(InputError, match=f"{count} posed image in it"):
        load_scene(colmap_scene(count=count))
