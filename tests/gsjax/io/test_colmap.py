"""COLMAP models as COLMAP and other programs write them: places, forms, names, keypoints, rotations, line ends."""

import os
import re
import shutil
import struct

import numpy as np
import pycolmap
import pytest

from gsjax.errors import InputError
from gsjax.io.colmap import find_model, read_capture, read_model
from gsjax.io.colmap_writer import write_whole
from gsjax.io.scenes import load_scene


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
        ("images.bin", lambda data: data[: len(data) // 20], "truncated"),
        ("points3D.bin", lambda data: data[:-1], "truncated"),
        ("cameras.bin", lambda data: data[:12] + struct.pack("<i", 77) + data[16:], "unknown camera model 77"),
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


@pytest.mark.parametrize(("name", "share"), [("cameras.bin", 0.0), ("points3D.bin", 0.99)])
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


def edit_images(root, change):
    """Changes the lines of `images.txt`; an image has two, the second blank."""
    file = root / "sparse/0/images.txt"
    lines = file.read_text().splitlines()
    file.write_text("".join(f"{line}\n" for line in change(lines)))
    return root


def rename(root, named):
    """Changes the names in `images.txt`."""
    return edit_images(root, lambda lines: [re.sub(r"\S+\.png$", lambda m: named(m[0]), line) for line in lines])


def longer_quaternions(line):
    return line.replace(" 1 0 0 0 ", " 2 0 0 0 ", 1)


@pytest.mark.parametrize(
    ("mark", "end", "keypoints", "change"),
    [
        (b"", b"\r\n", "", str),
        (b"\xef\xbb\xbf", b"\n", "1.5 2.5 1 3.5 4.5 -1", str),
        (b"", b"\n", None, longer_quaternions),
    ],
)
def test_text_of_other_programs_is_the_same_model(colmap_scene, mark, end, keypoints, change):
    """Byte order marks, line ends of Windows, images with and without lines of keypoints, unnormalised quaternions."""

    def images(lines):
        lines = [change(line) for line in lines if line and not line.startswith("#")]
        return [line for image in lines for line in (image, *([] if keypoints is None else [keypoints]))]

    root = edit_images(colmap_scene(text=True), images)
    for file in (root / "sparse/0").iterdir():
        lines = [line for line in file.read_bytes().split(b"\n") if not line.startswith(b"#")]
        file.write_bytes(mark + end.join(lines))
    scene = load_scene(root)
    assert [frame.name for frame in scene.frames] == [f"{i:03d}.png" for i in range(10)]
    assert len(scene.points) == 5 and len(scene.tracks().point) == (10 if keypoints else 0)
    for frame in scene.frames:
        np.testing.assert_allclose(frame.viewmat[:3, :3], np.eye(3), atol=1e-7)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (" 1 0 0 0 ", " 0 0 0 0 ", "images.txt: the quaternion of 00[0-9].png is zero"),
        (" 1 0 0 0 ", " one 0 0 0 ", "images.txt, line [0-9]+: is neither an image nor keypoints"),
        (" 1 00", " 7 00", "images.txt: 00[0-9].png is of camera 7, which the model does not have"),
    ],
)
def test_faults_of_images_are_named(colmap_scene, old, new, message):
    root = edit_images(colmap_scene(text=True), lambda lines: [line.replace(old, new, 1) for line in lines])
    with pytest.raises(InputError, match=message):
        load_scene(root)


@pytest.mark.parametrize(
    ("prefix", "inside"),
    [("/data/someone/images/", ""), ("C:\\Users\\me\\images\\", "left side/"), ("images\\", "")],
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
