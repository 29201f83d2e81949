import os
import shutil
import struct

import numpy as np
import pycolmap
import pytest

from gsjax.errors import InputError
from gsjax.io.colmap import read_capture
from gsjax.io.colmap_model import find_model, read_model
from gsjax.io.colmap_writer import write_whole
from gsjax.io.scenes import load_scene
from gsjax.scene.similarity import IDENTITY


def mean_reprojection_error(scene, model_folder) -> float:
    """Pixels between observations, sent into the frame, and the points projected by the frame's own matrices."""
    model = pycolmap.Reconstruction(model_folder)
    frames = {frame.name: frame for frame in scene.frames}
    errors = []
    for image in model.images.values():
        frame = frames[image.name]
        observations = [p for p in image.points2D if p.has_point3D()]
        world = np.array([model.points3D[p.point3D_id].xyz for p in observations])
        rays = np.asarray(image.camera.cam_from_img(np.array([p.xy for p in observations])))
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


@pytest.mark.parametrize("place", ["sparse", "colmap/sparse/0", "."])
def test_the_model_is_found_in_its_usual_places(colmap_scene, place, tmp_path):
    root = colmap_scene(count=3)
    moved = tmp_path / "moved"
    shutil.copytree(root / "images", moved / "images")
    shutil.copytree(root / "sparse/0", moved / place, dirs_exist_ok=True)
    assert find_model(moved) == moved / place
    assert len(load_scene(moved).frames) == 3


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("cameras.bin", lambda data: data[: len(data) // 2], "truncated"),
        ("images.bin", lambda data: data[: len(data) // 20], "truncated"),
        ("points3D.bin", lambda data: data[:-1], "truncated"),
        (
            "cameras.bin",
            lambda data: data[:12] + struct.pack("<i", 77) + data[16:],
            "unknown camera model 77 of camera 1",
        ),
    ],
)
def test_damaged_files_are_named(colmap_scene, name, change, message):
    root = colmap_scene(points=30)
    file = root / "sparse/0" / name
    file.write_bytes(change(file.read_bytes()))
    with pytest.raises(InputError, match=f"{name}: {message}") as error:
        load_scene(root)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("has_file", [True, False])
def test_a_model_without_points_starts_from_random_ones_in_view_and_says_so(colmap_scene, capsys, has_file):
    root = colmap_scene(points=0)
    if not has_file:
        (root / "sparse/0/points3D.bin").unlink()
    points = load_scene(root).points
    assert len(points) == 30_000 and points[:, 2].mean() > 0.1  # the cameras look along +z
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and str(root / "sparse/0") in message and "random" in message
    assert load_scene(root).tracks is None


def test_points_in_a_ply_alone_are_read(colmap_scene):
    root = colmap_scene()
    (root / "sparse/0/points3D.bin").unlink()
    header = "ply\nformat ascii 1.0\nelement vertex 1\n" + "".join(f"property float {a}\n" for a in "xyz")
    (root / "sparse/0/points3D.ply").write_text(header + "end_header\n1 2 3\n")
    np.testing.assert_array_equal(load_scene(root, similarity=IDENTITY).points, [[1, 2, 3]])


def test_of_several_models_the_largest_is_taken_and_told(colmap_scene, capsys):
    root = colmap_scene(count=4)
    large = (root / "sparse/0").rename(root / "sparse/1")
    small = pycolmap.Reconstruction(large)
    for number in (3, 4):
        small.deregister_frame(small.image(number).frame_id)
    (root / "sparse/0").mkdir()
    small.write_binary(root / "sparse/0")
    assert len(load_scene(root).frames) == 4
    message = capsys.readouterr().err
    assert message == f"COLMAP: {root / 'sparse/1'} with 4 photos is taken; there are also sparse/0 with 2\n"
    pycolmap.Reconstruction(large).write_text(large)
    for file in large.glob("*.bin"):
        file.unlink()
    assert find_model(root) == large
    shutil.rmtree(root / "sparse/0")
    assert find_model(root) == large


def test_of_two_forms_of_a_model_the_larger_is_taken_and_told(colmap_scene, capsys):
    root = colmap_scene(count=4)
    model = pycolmap.Reconstruction(root / "sparse/0")
    model.write_text(root / "sparse/0")
    assert len(load_scene(root).frames) == 4 and not capsys.readouterr().err
    model.deregister_frame(model.image(4).frame_id)
    model.write_binary(root / "sparse/0")
    assert len(load_scene(root).frames) == 4
    assert "images.txt with 4 photos is taken; images.bin beside it has 3" in capsys.readouterr().err


def test_names_of_numbers_are_no_keypoints(colmap_scene):
    root = colmap_scene(count=4, text=True)
    file = root / "sparse/0/images.txt"
    lines = [line for line in file.read_text().splitlines() if line.endswith(".png")]
    for number, line in enumerate(lines):
        name = line.split()[-1]
        (root / "images" / name).rename(root / "images" / f"{number} 1 2")
        lines[number] = line.replace(name, f"{number} 1 2")
    file.write_text("\n".join(lines))
    assert [frame.name for frame in load_scene(root).frames] == [f"{number} 1 2" for number in range(4)]


def test_a_model_that_promises_more_than_it_holds_is_not_the_largest(colmap_scene):
    root = colmap_scene(count=3)
    shutil.copytree(root / "sparse/0", root / "sparse/1")
    (root / "sparse/1/images.bin").write_bytes(b"\xff" * 8)
    assert find_model(root) == root / "sparse/0"


@pytest.mark.parametrize("text", [True, False])
@pytest.mark.parametrize("is_same", [True, False])
def test_two_cameras_of_one_id_are_refused_unless_they_are_the_same(colmap_scene, text, is_same):
    root = colmap_scene(count=3, text=text)
    file = root / "sparse/0" / ("cameras.txt" if text else "cameras.bin")
    whole = file.read_bytes()
    if text:
        line = whole.splitlines()[-1]
        file.write_bytes(whole + (line if is_same else line + b"9") + b"\n")
    else:
        assert whole[:8] == struct.pack("<Q", 1)
        file.write_bytes(struct.pack("<Q", 2) + whole[8:] + (whole[8:] if is_same else whole[8:-1] + b"\x41"))
    if is_same:
        assert len(load_scene(root).frames) == 3
    else:
        with pytest.raises(InputError, match="camera 1 is there twice"):
            load_scene(root)


class OnAFullDisk:
    """A model whose writer loses the end of one file and says nothing, as pycolmap's does."""

    def __init__(self, model, name, share):
        self.model, self.name, self.share = model, name, share

    def __getattr__(self, name):
        return getattr(self.model, name)

    def write_binary(self, folder):
        self.model.write_binary(folder)
        os.truncate(folder / self.name, int(self.share * (folder / self.name).stat().st_size))


@pytest.mark.parametrize(
    ("name", "share"), [("cameras.bin", 0.0), ("images.bin", 0.5), ("points3D.bin", 0.99), ("rigs.bin", 0.5)]
)
def test_a_model_that_was_cut_by_a_full_disk_is_told(colmap_scene, tmp_path, name, share):
    model = pycolmap.Reconstruction(colmap_scene() / "sparse/0")
    with pytest.raises(InputError, match="cannot write .*out: the model did not come whole onto the disk, which has"):
        write_whole(OnAFullDisk(model, name, share), tmp_path / "out")
    write_whole(model, tmp_path / "out")
    assert len(read_model(tmp_path / "out").images) == 10


def test_a_folder_that_cannot_be_written_is_told(colmap_scene, tmp_path):
    model = pycolmap.Reconstruction(colmap_scene() / "sparse/0")
    (tmp_path / "out/points3D.bin").mkdir(parents=True)
    with pytest.raises(InputError, match="cannot write .*out"):
        write_whole(model, tmp_path / "out")
