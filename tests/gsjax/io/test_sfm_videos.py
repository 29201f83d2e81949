"""Frames of a video for a reconstruction."""

import io
import shutil
import struct
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from tqdm import tqdm

from gsjax.errors import InputError
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


def test_a_video_of_high_dynamic_range_is_named_with_its_transfer_function(tmp_path, capsys, monkeypatch):
    """As its tables state it; pictures are not searched for it. The pixels are read of the video without it."""
    plain = write_video(tmp_path / "plain.mp4", noise_frames(4, sharp=()), "mp4v")
    for transfer, name in ((16, "PQ"), (18, "HLG"), (1, None), (14, None)):
        clip = with_colours(Path(shutil.copy(plain, tmp_path / "clip.mp4")), transfer)
        assert video.transfer_function(clip) == name
        with monkeypatch.context() as patched:
            patched.setattr(video, "_open", lambda _, opened=video._open: opened(plain))
            video.write_sharpest_frames(clip, tmp_path / f"frames_{transfer}", 2, quietly)
        named = f"{clip}: is coded for high dynamic range ({name})"
        assert [named in line for line in capsys.readouterr().err.splitlines()] == ([True] if name else [])
    plain.write_bytes(plain.read_bytes() + struct.pack(">I4s8sHHH", 22, b"free", b"colrnclx", 9, 18, 9))
    assert video.transfer_function(plain) is None


@pytest.mark.parametrize(("transfer", "name"), [(16, "PQ"), (18, "HLG"), (1, None)])
def test_matroska_states_its_transfer_function_in_its_head(tmp_path, transfer, name):
    head = b"\x1a\x45\xdf\xa3" + bytes(60) + b"\x55\xba\x81" + bytes([transfer]) + bytes(60)
    (tmp_path / "a.mkv").write_bytes(head)
    assert video.transfer_function(tmp_path / "a.mkv") == name
