"""Frames of a video for a reconstruction, and films that are written."""

import io
import json
import shutil
import struct
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io import video_writer
from gsjax.io.keyframe_files import read_keyframes
from gsjax.io.sfm import video

quietly = partial(tqdm, disable=True)


def write_video(path, frames, code="MJPG"):
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), 25, (width, height))
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


def noise_frames(count, sharp):
    """Blurred noise, but for the frames named."""
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 256, (48, 64, 3), dtype=np.uint8) for _ in range(count)]
    return [frame if i in sharp else cv2.GaussianBlur(frame, (0, 0), 2) for i, frame in enumerate(frames)]


def test_the_sharpest_frame_of_every_stretch_is_taken(tmp_path):
    clip = write_video(tmp_path / "clip.avi", noise_frames(20, sharp=(3, 5, 14, 19)))
    bars = []

    def progress(**settings):
        bars.append(tqdm(**settings, file=io.StringIO()))
        return bars[-1]

    video.write_sharpest_frames(clip, tmp_path / "frames", 4, progress)
    assert sorted(f.name for f in (tmp_path / "frames").iterdir()) == [f"{i:06d}.jpg" for i in (3, 5, 14, 19)]
    assert [(bar.n, bar.total) for bar in bars] == [(20, 20)]


def test_a_video_is_turned_as_it_says(tmp_path):
    clip = write_video(tmp_path / "clip.mp4", noise_frames(4, sharp=()), "mp4v")
    data = bytearray(clip.read_bytes())
    matrix = data.index(b"tkhd") + 44  # of the track header: where the picture's axes go, 16.16 fixed point
    one = 1 << 16
    data[matrix : matrix + 36] = np.array([0, one, 0, -one, 0, 0, 48 * one, 0, 1 << 30], ">i4").tobytes()
    clip.write_bytes(data)
    video.write_sharpest_frames(clip, tmp_path / "frames", 2, quietly)
    assert {cv2.imread(str(f)).shape for f in (tmp_path / "frames").iterdir()} == {(64, 48, 3)}


def test_unusable_videos_are_named(tmp_path):
    (tmp_path / "broken.mp4").write_bytes(b"no video")
    with pytest.raises(InputError, match=r"broken.mp4: not a video that can be read"):
        video.write_sharpest_frames(tmp_path / "broken.mp4", tmp_path / "frames", 4, quietly)
    clip = write_video(tmp_path / "one.avi", noise_frames(1, sharp=()))
    with pytest.raises(InputError, match=r"one.avi: needs at least 2 frames, has 1"):
        video.write_sharpest_frames(clip, tmp_path / "frames", 4, quietly)


def with_colours(clip, transfer):
    """The video with a `colr` box in its tables, as cameras leave one in that of the codec."""
    data = clip.read_bytes()
    at = data.index(b"moov") - 4
    (size,) = struct.unpack_from(">I", data, at)
    box = struct.pack(">I8sHHHB", 19, b"colrnclx", 9, transfer, 9, 0)
    moov = struct.pack(">I", size + len(box)) + data[at + 4 : at + size] + box
    clip.write_bytes(data[:at] + moov + data[at + size :])
    return clip


def test_the_transfer_function_of_high_dynamic_range_is_read(tmp_path):
    """As the tables of a video state it; pictures are not searched for it."""
    plain = write_video(tmp_path / "plain.mp4", noise_frames(4, sharp=()), "mp4v")
    for transfer, name in ((16, "PQ"), (18, "HLG"), (1, None)):
        clip = with_colours(Path(shutil.copy(plain, tmp_path / "clip.mp4")), transfer)
        assert video.transfer_function(clip) == name
    plain.write_bytes(plain.read_bytes() + struct.pack(">I4s8sHHH", 22, b"free", b"colrnclx", 9, 18, 9))
    assert video.transfer_function(plain) is None


POSES = [
    {"viewmat": np.eye(4).tolist(), "fov": 50.0},
    {"viewmat": [[0, -1, 0, 2], [1, 0, 0, 3], [0, 0, 1, 4.5], [0, 0, 0, 1]], "fov": 60},
]


@pytest.mark.parametrize("name", ["film.webm", "ü %03d.MP4"])
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


def test_a_gif_holds_every_picture_and_repeats(tmp_path):
    pictures = [np.full((10, 12, 3), 40 * k, np.uint8) for k in range(5)]
    video_writer.write_video(tmp_path / "a.GIF", pictures, 10.0, 12, 10)
    with Image.open(tmp_path / "a.GIF") as animation:
        assert (animation.n_frames, animation.info["duration"], animation.info["loop"]) == (5, 100, 0)
        for index in range(5):
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


def test_a_film_that_a_full_disk_cuts_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(video_writer, "_count_frames", lambda path: 1)
    with pytest.raises(InputError, match="not all of its 2 pictures are in it; the disk has .* bytes left"):
        video_writer.write_video(tmp_path / "film.mp4", np.zeros((2, 48, 64, 3), np.uint8), 24.0, 64, 48)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"closed": True, "keyframes": POSES[:2]}, "2 keyframes; a path has 3 or more"),
        ({"keyframes": [POSES[0], {"viewmat": np.eye(4).tolist()}]}, "lacks 'keyframes.1.fov'"),
        ({"keyframes": [POSES[0], POSES[1] | {"fov": 0}]}, "keyframes.1.fov 0 is not between 1 and 170"),
        ({"keyframes": [POSES[0], POSES[1] | {"viewmat": np.diag([1, 1, -1, 1]).tolist()}]}, "keyframes.1.view"),
    ],
)
def test_what_is_no_path_is_one_line(tmp_path, content, message):
    (tmp_path / "path.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=rf"path.json: {message}"):
        read_keyframes(tmp_path / "path.json")
