"""COLMAP models as COLMAP and other programs write them: places, forms, names, keypoints, rotations, line ends."""

import os
import re
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


@pytest.mark.parametrize("folder", ["fox", "fox/undistorted", "kitchen", "fern"])
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
    np.testing.assert_array_equal(np.c_[binary.points, binary.point_colors], np.c_[text.points, text.point_colors])
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
    (root / "sparse/0/images.bin").write_bytes(b"\xff" * 8)  # promises more than it holds
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
    root = rename(colmap_scene(count=4, text=True), lambda name: f"{int(name[:3])} 1 2")
    edit_images(root, lambda lines: filter(None, lines))
    for number in range(4):
        (root / f"images/{number:03d}.png").rename(root / f"images/{number} 1 2")
    assert [frame.name for frame in load_scene(root).frames] == [f"{number} 1 2" for number in range(4)]


@pytest.mark.parametrize("text", [True, False])
@pytest.mark.parametrize("is_same", [True, False])
def test_two_cameras_of_one_id_are_refused_unless_they_are_the_same(colmap_scene, text, is_same):
    root = colmap_scene(count=3, text=text)
    file = root / "sparse/0" / ("cameras.txt" if text else "cameras.bin")
    whole = file.read_bytes()
    if text:
        file.write_bytes(whole + whole.splitlines()[-1] + (b"\n" if is_same else b"9\n"))
    else:
        file.write_bytes(struct.pack("<Q", 2) + whole[8:] + (whole[8:] if is_same else whole[8:-1] + b"\x41"))
    if is_same:
        assert len(load_scene(root).frames) == 3
    else:
        with pytest.raises(InputError, match="camera 1 is there twice"):
            load_scene(root)


@pytest.mark.parametrize(
    ("name", "share"), [("cameras.bin", 0.0), ("images.bin", 0.5), ("points3D.bin", 0.99), ("rigs.bin", 0.5)]
)
def test_a_model_that_was_cut_by_a_full_disk_is_told(colmap_scene, tmp_path, monkeypatch, name, share):
    """pycolmap loses the end of a file and says nothing."""
    model, write = pycolmap.Reconstruction(colmap_scene() / "sparse/0"), pycolmap.Reconstruction.write_binary

    def cut(model, folder):
        write(model, folder)
        os.truncate(folder / name, int(share * (folder / name).stat().st_size))

    with monkeypatch.context() as patched:
        patched.setattr(pycolmap.Reconstruction, "write_binary", cut)
        with pytest.raises(InputError, match="cannot write .*out: the model did not come whole onto the disk"):
            write_whole(model, tmp_path / "out")
    write_whole(model, tmp_path / "out")
    assert len(read_model(tmp_path / "out").images) == 10
    (tmp_path / "not/points3D.bin").mkdir(parents=True)
    with pytest.raises(InputError, match="cannot write .*not"):
        write_whole(model, tmp_path / "not")


def edit_images(root, change):
    """Changes the lines of `images.txt`; an image has two, the second blank."""
    file = root / "sparse/0/images.txt"
    lines = file.read_text().splitlines()
    file.write_text("".join(f"{line}\n" for line in change(lines)))
    return root


def rename(root, named):
    """Changes the names in `images.txt`."""
    return edit_images(root, lambda lines: [re.sub(r"\S+\.png$", lambda m: named(m[0]), line) for line in lines])


@pytest.mark.parametrize("keypoints", ["", "1.5 2.5 1 3.5 4.5 -1", None])
def test_every_image_is_read_with_and_without_lines_of_keypoints(colmap_scene, keypoints):
    def change(lines):
        images = [line for line in lines if line and not line.startswith("#")]
        return [line for image in images for line in (image, *([] if keypoints is None else [keypoints]))]

    root = edit_images(colmap_scene(text=True), change)
    scene = load_scene(root)
    assert [f.name for f in scene.frames] == [f"{i:03d}.png" for i in range(10)]
    assert len(scene.tracks().point) == (10 if keypoints else 0)


@pytest.mark.parametrize("quat", ["2 0 0 0", "0.99 0 0 0", "-1 0 0 0"])
def test_quaternions_of_any_length_turn_and_do_not_shear(colmap_scene, quat):
    root = colmap_scene(text=True)
    edit_images(root, lambda lines: [line.replace(" 1 0 0 0 ", f" {quat} ", 1) for line in lines])
    for frame in load_scene(root).frames:
        np.testing.assert_allclose(frame.viewmat[:3, :3], np.eye(3), atol=1e-7)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (" 1 0 0 0 ", " 0 0 0 0 ", "images.txt: the quaternion of 00[0-9].png is zero"),
        (" 1 0 0 0 ", " nan 0 0 0 ", "images.txt: the pose of 00[0-9].png is not finite"),
        (" 1 0 0 0 ", " one 0 0 0 ", "images.txt, line [0-9]+: is neither an image nor keypoints"),
        (" 1 00", " 7 00", "images.txt: 00[0-9].png is of camera 7, which the model does not have"),
    ],
)
def test_faults_of_images_are_named(colmap_scene, old, new, message):
    root = edit_images(colmap_scene(text=True), lambda lines: [line.replace(old, new, 1) for line in lines])
    with pytest.raises(InputError, match=message):
        load_scene(root)


def test_colours_of_fractions_are_shares(colmap_scene):
    root = colmap_scene(points=2, text=True)
    file = root / "sparse/0/points3D.txt"
    file.write_text("1 0 1 5 0.2 0.5 1.0 -1\n2 1 1 5 0 1 0.75 -1\n")
    np.testing.assert_array_equal(load_scene(root).point_colors, [[51, 128, 255], [0, 255, 191]])


@pytest.mark.parametrize(("mark", "end"), [(b"", b"\r\n"), (b"\xef\xbb\xbf", b"\n")])
def test_byte_order_marks_and_line_ends_of_windows_change_nothing(colmap_scene, mark, end):
    root = colmap_scene(text=True)
    for file in (root / "sparse/0").iterdir():
        lines = [line for line in file.read_bytes().split(b"\n") if not line.startswith(b"#")]
        file.write_bytes(mark + end.join(lines))
    scene = load_scene(root)
    assert len(scene.frames) == 10 and len(scene.points) == 5


@pytest.mark.parametrize(
    ("prefix", "inside"),
    [("/data/someone/images/", ""), ("C:\\Users\\me\\images\\", "left/"), ("../other/", "left/"), ("images\\", "")],
)
def test_paths_of_another_machine_are_found_by_their_last_parts(colmap_scene, prefix, inside, capsys):
    root = colmap_scene(text=True)
    (root / "images").rename(root / "photos")
    (root / "images" / inside).parent.mkdir(parents=True, exist_ok=True)
    (root / "photos").rename(root / "images" / inside)
    listed = inside.replace("/", "\\") if "\\" in prefix else inside
    rename(root, lambda name: f"{prefix}{listed}{name}")
    frames = load_scene(root).frames
    assert [f.name for f in frames] == [f"{inside}{i:03d}.png" for i in range(10)]
    assert [frame.pixels().image.shape for frame in frames] == [(30, 40, 3)] * 10
    assert ("of another machine" in capsys.readouterr().err) == (prefix != "images\\")


def test_paths_of_another_machine_that_end_alike_are_not_confused(colmap_scene):
    root = colmap_scene(count=2, text=True)
    rename(root, lambda name: f"/cam{name[2]}/images/000.png")
    with pytest.raises(InputError, match="no such image; 2 of 2 photos .*: cam0/images/000.png, cam1/images/000.png"):
        load_scene(root)


@pytest.mark.parametrize("text", [True, False])
def test_names_in_latin1_are_found_by_their_bytes_or_as_unicode(colmap_scene, text):
    root = colmap_scene(count=4, text=text)
    model = root / "sparse/0" / ("images.txt" if text else "images.bin")
    model.write_bytes(re.sub(rb"00(?=[0-9].png)", b"\xfc\xe9", model.read_bytes()))
    decomposed = "u\u0308e\u03012.png"
    on_disk = ["üé0.png".encode("latin-1"), "üé1.png".encode(), decomposed.encode(), b"\xfc\xe93.png"]
    for i, name in enumerate(on_disk):
        (root / f"images/00{i}.png").rename(os.fsdecode(os.fsencode(root / "images") + b"/" + name))
    frames = load_scene(root).frames
    assert [f.name for f in frames] == [f"üé{i}.png" for i in range(4)]
    assert [frame.pixels().image.shape for frame in frames] == [(30, 40, 3)] * 4
