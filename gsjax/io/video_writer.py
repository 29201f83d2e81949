"""Video files (.mp4, .webm, .gif) that browsers play."""

import shutil
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from PIL import Image

from gsjax.errors import InputError
from gsjax.io.files import atomic_path
from gsjax.io.images import cv2

CODECS = {".mp4": "vp09", ".webm": "VP90"}
"""VP9 in both: the wheels of OpenCV have no H.264, whose encoder is under the GPL."""
SUFFIXES = (*CODECS, ".gif")
GIF_BYTES = 6  # A pixel of every picture: PIL holds them all, and the copies that it writes.


def is_video(path: str | Path) -> bool:
    """Whether the suffix of a file is one of `SUFFIXES`."""
    return Path(path).suffix.lower() in SUFFIXES


def write_video(path: str | Path, pictures: Iterable[np.ndarray], fps: float, width: int, height: int) -> None:
    """Write pictures `[height, width, 3]` uint8, of even sides, as a video, whole or not at all.

    A GIF repeats for ever, and shows each picture for hundredths of a second, 0.02 at least.

    Raises:
        InputError: The codec is not in this OpenCV, or the file cannot be written.
    """
    with atomic_path(path) as temporary:
        if temporary.suffix.lower() == ".gif":
            _write_gif(temporary, pictures, fps)
            return
        temporary.touch()  # The error of a folder that cannot be written: OpenCV reports none.
        codec = cv2.VideoWriter.fourcc(*CODECS[temporary.suffix.lower()])
        writer = cv2.VideoWriter(str(temporary), cv2.CAP_FFMPEG, codec, fps, (width, height))
        if not writer.isOpened():
            raise _unwritten(path, temporary, "OpenCV opened no writer of VP9")
        count = 0
        try:
            for picture in pictures:
                writer.write(np.ascontiguousarray(picture[..., ::-1]))
                count += 1
        finally:
            writer.release()
        if _count_frames(temporary) != count:  # A full disk, of which OpenCV reports nothing.
            raise _unwritten(path, temporary, f"not all of its {count} pictures are in it")


def _write_gif(path: Path, pictures: Iterable[np.ndarray], fps: float) -> None:
    first, *rest = (Image.fromarray(picture) for picture in pictures)
    first.save(path, save_all=True, append_images=rest, duration=max(round(1000 / fps), 20), loop=0)


def _unwritten(path: str | Path, temporary: Path, fault: str) -> InputError:
    left = shutil.disk_usage(temporary.parent).free
    return InputError(f"cannot write {path}: {fault}; the disk has {left} bytes left")


def _count_frames(path: Path) -> int:
    film = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        return round(film.get(cv2.CAP_PROP_FRAME_COUNT)) if film.isOpened() else 0
    finally:
        film.release()
