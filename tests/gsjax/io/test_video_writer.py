"""Films come back picture by picture, and paths that are none are refused in one line."""

import json
from types import SimpleNamespace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from fuzzing import fuzz_files
from PIL import Image

from gsjax.errors import InputError
from gsjax.io import video_writer
from gsjax.io.keyframe_files import read_keyframes

POSES = [
    {"viewmat": np.eye(4).tolist(), "fov": 50.0},
    {"viewmat": [[0, -1, 0, 2], [1, 0, 0, 3], [0, 0, 1, 4.5], [0, 0, 0, 1]], "fov": 60},
    {"viewmat": np.diag([1, -1, -1, 1]).tolist(), "fov": 40.0},
]
UNOPENED = Mock(**{"VideoWriter.return_value.isOpened.return_value": False})
"""OpenCV on a disk without room."""


@pytest.mark.parametrize("name", ["film.mp4", "film.webm", "ü %03d.MP4"])
def test_a_film_comes_back(tmp_path, name):
    ramp = np.linspace(0, 255, 64).astype(np.uint8)[None, :, None] * np.ones((48, 1, 1), np.uint8)
    shades = [ramp * np.uint8([1, 0, 0]), ramp * np.uint8([0, 1, 0]), ramp * np.uint8([0, 0, 1])] * 4
    video_writer.write_video(tmp_path / name, shades, 24.0, 64, 48)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    film = cv2.VideoCapture(str(tmp_path / name), cv2.CAP_FFMPEG)
    assert film.get(cv2.CAP_PROP_FPS) == 24
    for shade in shades:
        there, picture = film.read()
        assert there and np.abs(picture[..., ::-1].astype(int) - shade).mean() < 12
    assert not film.read()[0]


@pytest.mark.parametrize("count", [1, 5])
def test_a_gif_holds_every_picture_and_repeats(tmp_path, count):
    video_writer.write_video(
        tmp_path / "a.GIF", [np.full((10, 12, 3), 40 * k, np.uint8) for k in range(count)], 10.0, 12, 10
    )
    with Image.open(tmp_path / "a.GIF") as animation:
        assert (animation.n_frames, animation.info["duration"], animation.info["loop"]) == (count, 100, 0)
        for index in range(count):
            animation.seek(index)
            assert np.abs(np.asarray(animation.convert("RGB")).astype(int) - 40 * index).max() <= 2
    assert [path.name for path in tmp_path.iterdir()] == ["a.GIF"]


@pytest.mark.parametrize("name", ["film.mp4", "film.gif"])
def test_a_film_that_is_stopped_or_cannot_be_written_leaves_nothing(tmp_path, name):
    def stopped():
        yield np.zeros((48, 64, 3), np.uint8)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        video_writer.write_video(tmp_path / name, stopped(), 24.0, 64, 48)
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=f"cannot write .*{name}"):
        video_writer.write_video(tmp_path / "file" / name, [np.zeros((48, 64, 3), np.uint8)], 24.0, 64, 48)


@pytest.mark.parametrize(
    ("name", "replacement", "fault"),
    [
        ("_count_frames", lambda path: 1, "not all of its 2 pictures are in it"),
        ("cv2", UNOPENED, "OpenCV opened no writer of VP9"),
    ],
)
def test_a_film_that_a_full_disk_cuts_is_refused(tmp_path, monkeypatch, name, replacement, fault):
    monkeypatch.setattr(video_writer, name, replacement)
    monkeypatch.setattr(video_writer.shutil, "disk_usage", lambda folder: SimpleNamespace(free=512))
    with pytest.raises(InputError, match=f"{fault}; the disk has 512 bytes left"):
        video_writer.write_video(tmp_path / "film.mp4", np.zeros((2, 48, 64, 3), np.uint8), 24.0, 64, 48)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "the whole is a list of 0, expected a table"),
        ({"keyframes": POSES[:1]}, "1 keyframes; a path has 2 or more"),
        ({"closed": True, "keyframes": POSES[:2]}, "2 keyframes; a path has 3 or more"),
        ({"keyframes": [POSES[0], {"viewmat": np.eye(4).tolist()}]}, "lacks 'keyframes.1.fov'"),
        ({"keyframes": [POSES[0], POSES[1] | {"fov": 0}]}, "keyframes.1.fov 0 is not between 1 and 170"),
        ({"keyframes": [POSES[0], POSES[1] | {"viewmat": np.diag([1, 1, -1, 1]).tolist()}]}, "keyframes.1.view"),
        ({"keyframes": [POSES[0], POSES[1] | {"viewmat": np.eye(3).tolist()}]}, "keyframes.1.viewmat is a list of 3"),
    ],
)  # fmt: skip
def test_what_is_no_path_is_one_line(tmp_path, content, message):
    (tmp_path / "path.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=rf"path.json: {message}"):
        read_keyframes(tmp_path / "path.json")


def test_fuzz_paths(tmp_path):
    path = tmp_path / "path.json"
    path.write_text(json.dumps({"closed": False, "keyframes": POSES}))

    def read():
        assert np.isfinite(read_keyframes(path).viewmats).all()

    assert all(fuzz_files(read, path, usual=100))
