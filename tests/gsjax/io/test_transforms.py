import json
import re

import cv2
import numpy as np
import pytest
from transforms_ring import edit, red_behind_glass, ring, write

from gsjax.errors import InputError
from gsjax.io.scenes import load_scene
from gsjax.io.transforms import read_transforms


def test_poses_put_the_target_on_the_axis_and_up_is_up(tmp_path):
    scene = load_scene(write(tmp_path, fl_x=50.0, fl_y=52.0, cx=21.0, cy=14.0, w=40, h=30))
    for frame in scene.frames:
        target = frame.viewmat @ np.array([0, 0, 0, 1.0])
        np.testing.assert_allclose(target[:3], [0, 0, np.hypot(2, 0.5)], atol=1e-6)
        above = frame.viewmat @ np.array([0, 0, 0.1, 1.0])
        assert above[1] < -0.05  # y points down
        np.testing.assert_allclose(frame.viewmat[:3, :3] @ frame.viewmat[:3, :3].T, np.eye(3), atol=1e-6)
    np.testing.assert_array_equal(scene.frames[0].K, np.array([[50, 0, 21], [0, 52, 14], [0, 0, 1]], np.float32))
    assert [f.name for f in scene.frames] == [f"{i:03d}.png" for i in range(8)]
    assert [f.held_out for f in scene.frames] == [True] + [False] * 7
    assert scene.source == "transforms"


def test_fisheye_coefficients_and_frames_of_their_own(tmp_path):
    meta = {"camera_model": "OPENCV_FISHEYE", "fl_x": 30.0, "fl_y": 30.0, "k1": 0.1, "k4": 0.01}
    root = write(tmp_path, **meta)
    edit(root, lambda m: m["frames"][1].update(fl_x=33.0, k1=0.2))
    photos = read_transforms(root).photos
    assert photos[0].lens.model == "OPENCV_FISHEYE"
    assert photos[0].lens.params == (30.0, 30.0, 20.0, 15.0, 0.1, 0.0, 0.0, 0.01)
    assert photos[1].lens.params == (33.0, 30.0, 20.0, 15.0, 0.2, 0.0, 0.0, 0.01)


def test_random_points_surround_what_the_cameras_look_at_and_keep_clear_of_them(tmp_path):
    target = np.array([3.0, -2.0, 1.0])
    scene = load_scene(write(tmp_path, camera_angle_x=0.8, poses=ring(target=target)))
    again = load_scene(tmp_path)
    np.testing.assert_array_equal(scene.points, again.points)
    reach = np.hypot(2, 0.5)
    assert scene.points.shape == (30_000, 3)
    np.testing.assert_allclose(scene.points.mean(0), target, atol=0.15)
    assert np.abs(scene.points - target).max() <= 1.03 * reach
    assert np.abs(scene.points - target).max(0).min() > 0.95 * reach
    centers = np.array([-f.viewmat[:3, :3].T @ f.viewmat[:3, 3] for f in scene.frames])
    nearest = np.linalg.norm(scene.points[:, None] - centers[None], axis=-1).min()
    assert nearest > 0.24 * reach
    assert scene.point_colors.min() >= 64 and scene.point_colors.max() < 192


def test_points_of_the_named_file_are_taken(tmp_path):
    root = write(tmp_path, fl_x=50.0, ply_file_path="cloud.ply")
    with pytest.raises(InputError, match=r"cloud.ply: cannot be read"):
        load_scene(root)
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    header = f"ply\nformat ascii 1.0\nelement vertex 2\n{properties}end_header\n"
    (root / "cloud.ply").write_text(f"{header}1 2 3\n4 5 6\n")
    np.testing.assert_array_equal(load_scene(root).points, [[1, 2, 3], [4, 5, 6]])


def test_nerf_synthetic_keeps_its_own_split_and_its_alpha(tmp_path):
    write(tmp_path, "transforms_train.json", "train", suffix="", camera_angle_x=0.8)
    write(tmp_path, "transforms_test.json", "test", suffix="", camera_angle_x=0.8, poses=ring(3))
    write(tmp_path, "transforms_val.json", "val", suffix="", camera_angle_x=0.8, poses=ring(3))
    scene = load_scene(tmp_path)
    assert scene.source == "nerf-synthetic"
    focal = 20 / np.tan(0.4)
    np.testing.assert_allclose(scene.frames[0].K, [[focal, 0, 20], [0, focal, 15], [0, 0, 1]], rtol=1e-6)
    assert not load_scene(tmp_path, hold_out="none").held_out_frames
    assert [f.name for f in scene.held_out_frames] == [f"test/{i:03d}.png" for i in range(3)]
    assert [f.name for f in scene.train_frames] == [f"train/{i:03d}.png" for i in range(8)]
    np.testing.assert_array_equal(scene.frames[0].pixels().matte, red_behind_glass()[..., 3])
    assert (scene.frames[0].pixels().image == (255, 0, 0)).all()
    assert scene.points.shape == (30_000, 3) and 1.29 < np.abs(scene.points).max() <= 1.3


@pytest.mark.parametrize("name", ["RADIAL", "FULL_OPENCV", "perspective", "Simple_Radial"])
def test_radial_cameras_by_any_name_and_case_are_one_lens(tmp_path, name):
    root = write(tmp_path, fl_x=50.0, fl_y=51.0, camera_model=name, k1=0.1, k2=0.2, p1=0.3, p2=0.4)
    params = {photo.lens.params for photo in read_transforms(root).photos}
    assert params == {(50, 51, 20, 15, 0.1, 0.2, 0.3, 0.4, *[0] * 4)}


def names(scene, which):
    return [int(frame.name[:3]) for frame in getattr(scene, which)]


def listing(*numbers):
    return [f"images/{number:03d}.png" for number in numbers]


def test_the_split_that_nerfstudio_lists_is_taken_and_gives_way_to_another(tmp_path, capsys):
    root = write(tmp_path, fl_x=50.0, train_filenames=listing(0, 1, 2), test_filenames=listing(4, 5))
    scene = load_scene(root)
    assert names(scene, "train_frames") == [0, 1, 2] and names(scene, "held_out_frames") == [4, 5]
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and "0 of its frames are left out as bad, 3 as being in no list" in message
    assert names(load_scene(root, hold_out="none"), "train_frames") == [0, 1, 2, 4, 5]
    edit(root, lambda m: m.pop("test_filenames"))
    assert names(load_scene(root), "held_out_frames") == [3, 4, 5, 6, 7]
    edit(root, lambda m: [frame.update(split="test" if k == 6 else "train") for k, frame in enumerate(m["frames"])])
    assert names(load_scene(root), "held_out_frames") == [6]
    edit(root, lambda m: m.update(val_filenames=[".\\images\\002.png"], train_filenames=listing(*range(8))))
    assert names(load_scene(root), "held_out_frames") == [2, 6]


@pytest.mark.parametrize(
    ("layout", "tests"), [("transforms.json", "transforms_val.json"), ("transforms_train.json", "transforms_test.json")]
)
def test_a_file_for_testing_beside_the_other_holds_out_its_photos(tmp_path, layout, tests):
    root = write(tmp_path, file=layout, camera_angle_x=0.8)
    meta = json.loads((root / layout).read_text())
    (root / tests).write_text(json.dumps({**meta, "frames": meta["frames"][5:]}))
    edit(root, lambda m: m.update(frames=m["frames"][:6]), file=layout)
    assert names(load_scene(root), "held_out_frames") == [5, 6, 7]
    assert len(load_scene(root).frames) == 8


def test_bad_frames_and_frames_for_testing_of_scannet(tmp_path, capsys):
    root = write(tmp_path, fl_x=50.0)

    def change(meta):
        meta["frames"][1]["is_bad"] = "true"
        meta["frames"][2]["is_bad"] = False
        meta["test_frames"] = [meta["frames"].pop(5), meta["frames"].pop()]

    edit(root, change)
    scene = load_scene(root)
    assert names(scene, "train_frames") == [0, 2, 3, 4, 6] and names(scene, "held_out_frames") == [5, 7]
    assert "1 of its frames are left out as bad" in capsys.readouterr().err


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
def test_json_of_every_encoding_is_read(tmp_path, encoding):
    root = write(tmp_path, fl_x=50.0, title="K\u00fcche")
    text = (root / "transforms.json").read_text().replace("\\u00fc", "\u00fc")
    (root / "transforms.json").write_bytes(text.encode(encoding))
    assert len(load_scene(root).frames) == 8


def test_a_linked_folder_of_photos_is_named_as_if_it_were_there(tmp_path, monkeypatch):
    """Masks beside it, or named in the file, are its masks; names are the same from wherever the scene is loaded."""
    root = write(tmp_path / "scene", fl_x=50.0)
    (root / "images").rename(tmp_path / "disk")
    (root / "images").symlink_to(tmp_path / "disk")
    mask = np.full((30, 40), 255, np.uint8)
    mask[:, 20:] = 0
    (root / "masks").mkdir()
    cv2.imwrite(str(root / "masks/000.png"), mask)
    edit(root, lambda m: [f.update(file_path=str(root / f["file_path"])) for f in m["frames"]])
    edit(root, lambda m: m["frames"][2].update(mask_path="masks/000.png"))
    monkeypatch.chdir(tmp_path)
    for folder in ("scene", root):
        frames = load_scene(folder).frames
        assert [frame.name for frame in frames] == [f"{i:03d}.png" for i in range(8)]
        assert [frame.pixels().valid is not None for frame in frames] == [True, False, True] + 5 * [False]
        for frame in (frames[0], frames[2]):
            np.testing.assert_array_equal(frame.pixels().valid, mask)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.pop("frames"), 'has no list "frames"'),
        (lambda m: m.update(train_filenames=["images/gone.png"]), "gone.png, which is the file_path of no frame"),
        (lambda m: m.update(frames=[f | {"is_bad": True} for f in m["frames"]]), "leaves all of its frames out"),
        (lambda m: m.pop("fl_x"), "neither fl_x nor camera_angle_x"),
        (lambda m: m.update(fl_x=-5.0), "(PINHOLE 40x30 with -5, -5, 20, 15) has a focal length that is not positive"),
        (lambda m: m.update(camera_model="LENSBABY"), "unknown camera_model 'LENSBABY'"),
        (lambda m: m.update(k4=0.1), "takes no k4"),
        (lambda m: m.update(w=80, h=50), "image is 40x30 but its camera says 80x50"),
        (lambda m: m.update(frames=m["frames"][:1]), "1 posed image in it"),
    ],
)
def test_faults_are_named(tmp_path, change, message):
    root = write(tmp_path, fl_x=50.0)
    edit(root, change)
    with pytest.raises(InputError) as error:
        load_scene(root)
    assert message in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m["frames"][3].pop("file_path"), 'frame 3 has no "file_path"'),
        (lambda m: m["frames"][3].update(transform_matrix=[[1, 2], [3, 4]]), "003.png is not a finite 4x4 matrix"),
        (lambda m: m["frames"][3].update(transform_matrix=np.diag([1, 2, 1, 1.0]).tolist()), "stretches by 2, 1, 1"),
        (lambda m: m["frames"][3].update(transform_matrix=np.diag([1, -1, 1, 1.0]).tolist()), "it mirrors"),
        (lambda m: m["frames"][3].update(mask_path="gone.png"), "gone.png: no such image"),
        (lambda m: m["frames"][3].update(file_path="images/gone.png"), "gone.png: no such image"),
        (lambda m: m["frames"][3].update(file_path="images/002.png"), "listed more than once, with several cameras"),
    ],
)
def test_a_frame_with_a_fault_is_left_out_and_named(tmp_path, capsys, change, message):
    root = write(tmp_path, fl_x=50.0)
    whole = [frame.name for frame in load_scene(root).frames]
    edit(root, change)
    left = [frame.name for frame in load_scene(root).frames]
    assert set(whole) - set(left) <= {"002.png", "003.png"} and len(left) in (len(whole) - 1, len(whole) - 2)
    output = capsys.readouterr().err
    assert message in output and re.search("is left out(: .*)?\n", output)
