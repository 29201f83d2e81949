"""Lists of images in COLMAP models as other programs write them: names, keypoints, rotations, line ends."""

import os
import re

import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.io.scenes import load_scene


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


@pytest.mark.parametrize(
    ("model", "params", "text"),
    [
        ("PINHOLE", (30, 0, 20, 15), True),
        ("PINHOLE", (30, -31, 20, 15), False),
        ("SIMPLE_RADIAL", (0, 20, 15, 0), True),
    ],
)
def test_focal_lengths_that_are_not_positive_are_refused(colmap_scene, model, params, text):
    root = colmap_scene(model=model, params=params, text=text)
    with pytest.raises(InputError, match=r"cameras.(txt|bin): camera 1 \(.*has a focal length that is not positive"):
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


@pytest.mark.parametrize("count", [0, 1])
def test_a_single_image_is_refused(colmap_scene, count):
    with pytest.raises(InputError, match=f"{count} posed image in it"):
        load_scene(colmap_scene(count=count))
