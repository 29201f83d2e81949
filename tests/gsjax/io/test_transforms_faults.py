"""Faults of a transforms.json: named in one line, and a frame with one is left out."""

import json
import re

import numpy as np
import pytest
from transforms_ring import edit, write

from gsjax.errors import InputError
from gsjax.io.scenes import load_scene


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.pop("frames"), 'has no list "frames"'),
        (lambda m: m.update(train_filenames=["images/gone.png"]), "gone.png, which is the file_path of no frame"),
        (lambda m: m.update(test_filenames=7), "test_filenames is no list of names"),
        (lambda m: m.update(frames=[f | {"is_bad": True} for f in m["frames"]]), "leaves all of its frames out"),
        (lambda m: m.update(camera_model=["OPENCV"]), "unknown camera_model that is no text"),
        (lambda m: m.update(cx=[1]), "has cx a list, which is no number"),
        (lambda m: m.update(fl_x=None, camera_angle_x=7), "camera_angle_x 7, which is no angle"),
        (lambda m: m.pop("fl_x"), "neither fl_x nor camera_angle_x"),
        (lambda m: m.update(cx=-9e6), "has a principal point that lies 100 times its size away"),
        (lambda m: m.update(fl_x=-5.0), "(PINHOLE 40x30 with -5, -5, 20, 15) has a focal length that is not positive"),
        (lambda m: m.update(fl_x=10**300), "has fl_x 100000000000000000...0000000000000000000, which is no number"),
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
        (lambda m: m["frames"][3].update(transform_matrix=(np.eye(4) + np.eye(4, k=-3)).tolist()), "a row 0, 0, 0, 1"),
        (lambda m: m["frames"][3].update(mask_path=7), "mask_path is no text"),
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


@pytest.mark.parametrize("name", ["images/a\0b.png", "images/\ud800.png", f"images/{300 * 'x'}.png"])
def test_a_frame_of_a_name_that_no_disk_holds_is_left_out(tmp_path, capsys, name):
    root = write(tmp_path, fl_x=50.0)
    whole = [frame.name for frame in load_scene(root).frames]
    edit(root, lambda m: m["frames"][3].update(file_path=name))
    assert [frame.name for frame in load_scene(root).frames] == whole[:3] + whole[4:]
    output = capsys.readouterr().err
    assert output.count("\n") == 1 and f"1 of {len(whole)} " in output and "is left out" in output


def test_poses_for_testing_whose_pictures_were_never_rendered_are_left_out(tmp_path, capsys):
    """More of them than photos: nothing of training is missing, and every 8th photo is held out."""
    root = write(tmp_path, fl_x=50.0, w=40, h=30)
    meta = json.loads((root / "transforms.json").read_text())
    tests = [{**meta["frames"][0], "file_path": f"test/{index}.png"} for index in range(20)]
    (root / "transforms_test.json").write_text(json.dumps({**meta, "frames": tests}))
    scene = load_scene(root)
    assert [frame.name for frame in scene.held_out_frames] == [frame.name for frame in scene.frames][::8]
    assert "test/0.png: no such image; 20 of 20 photos for testing are left out: " in capsys.readouterr().err
