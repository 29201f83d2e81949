"""Films (.mp4, .webm, .gif) that browsers play, and files of keyframes of a camera path."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.files import atomic_path
from gsjax.io.packages import Deferred
from gsjax.scene.camera_path import Keyframes

cv2: Any = Deferred("cv2")

CODECS = {".mp4": "vp09", ".webm": "VP90"}
"""VP9 in both: the wheels of OpenCV have no H.264, whose encoder is under the GPL."""
SUFFIXES = (*CODECS, ".gif")
GIF_BYTES = 6  # A pixel of every picture: PIL holds them all, and the copies that it writes.
FOVS = 1.0, 170.0  # degrees
_SHAPE = {"closed?": bool, "keyframes": [{"viewmat": [[float, 4], 4], "fov": float}]}
_RIGID = 1e-3  # Most that a product of a rotation with itself may differ from the identity.


def is_film(path: str | Path) -> bool:
    """Whether the suffix of a file is one of `SUFFIXES`."""
    return Path(path).suffix.lower() in SUFFIXES


def write_film(path: str | Path, pictures: Iterable[np.ndarray], fps: float, width: int, height: int) -> None:
    """Write a film, whole or not at all.

    Args:
        path: Its suffix is one of `SUFFIXES`. A GIF repeats for ever.
        pictures: `[height, width, 3]` uint8 each.
        fps: Pictures a second. Those of a GIF are shown for hundredths of a second, 0.02 at least.
        width: Pixels, even.
        height: Pixels, even.

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
            raise InputError(f"cannot write {path}: this OpenCV cannot encode VP9")
        count = 0
        try:
            for picture in pictures:
                writer.write(np.ascontiguousarray(picture[..., ::-1]))
                count += 1
        finally:
            writer.release()
        if _count_frames(temporary) != count:  # A full disk, of which OpenCV reports nothing.
            raise InputError(f"cannot write {path}: not all of its {count} pictures are in it; is the disk full?")


def _write_gif(path: Path, pictures: Iterable[np.ndarray], fps: float) -> None:
    first, *rest = (Image.fromarray(picture) for picture in pictures)
    first.save(path, save_all=True, append_images=rest, duration=max(round(1000 / fps), 20), loop=0)


def read_path(path: str | Path) -> Keyframes:
    """Read the keyframes of a camera path from a JSON file, in the coordinates of the file.

    `{"closed": false, "keyframes": [{"viewmat": [[...], ...], "fov": 50.0}, ...]}`: 4x4 matrices by rows, world to
    camera, OpenCV axes, as `cameras.json` of a run has them; vertical angles of view in degrees.

    Raises:
        InputError: It cannot be read, has another shape, too few keyframes, or one that is no pose or no angle of view.
    """
    record = json_files.read(path, _SHAPE)
    closed, frames = record.get("closed", False), record["keyframes"]
    if len(frames) < 2 + closed:
        raise InputError(f"{path}: {len(frames)} keyframes; a path has {2 + closed} or more")
    viewmats = np.array([frame["viewmat"] for frame in frames], np.float64)
    for index, (viewmat, frame) in enumerate(zip(viewmats, frames, strict=True)):
        rotation = viewmat[:3, :3]
        is_rigid = np.abs(rotation).max() < 2 and np.abs(rotation @ rotation.T - np.eye(3)).max() < _RIGID
        if not (is_rigid and np.linalg.det(rotation) > 0 and (viewmat[3] == [0, 0, 0, 1]).all()):
            raise InputError(f"{path}: keyframes.{index}.viewmat is no rigid map from world to camera")
        if not FOVS[0] <= frame["fov"] <= FOVS[1]:
            raise InputError(
                f"{path}: keyframes.{index}.fov {frame['fov']:g} is not between {FOVS[0]:g} and {FOVS[1]:g}"
            )
    return Keyframes(viewmats, np.radians([frame["fov"] for frame in frames]), closed)


def _count_frames(path: Path) -> int:
    film = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        return round(film.get(cv2.CAP_PROP_FRAME_COUNT)) if film.isOpened() else 0
    finally:
        film.release()
