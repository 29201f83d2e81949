"""Films: pictures one after the other in a file that browsers play, and the files that tell a camera's flight."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from gsjax.camera_path import Keyframes
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.files import atomic_path
from gsjax.io.packages import require

cv2 = require("cv2", "pip install opencv-contrib-python-headless")

CODECS = {".mp4": "vp09", ".webm": "VP90"}
"""VP9 in both: the wheels of OpenCV have no H.264, whose encoder is under the GPL."""
FOVS = 1.0, 170.0  # degrees
_SHAPE = {"closed?": bool, "keyframes": [{"viewmat": [[float, 4], 4], "fov": float}]}
_RIGID = 1e-3  # Most that a product of a rotation with itself may differ from the identity.


def check_film(path: str | Path) -> None:
    """Raises InputError unless a file's suffix is one of `CODECS`."""
    if Path(path).suffix.lower() not in CODECS:
        raise InputError(f"--out {path}: a film ends in {' or '.join(CODECS)}")


@contextmanager
def film_writer(path: str | Path, fps: float, width: int, height: int) -> Iterator[Callable[[np.ndarray], None]]:
    """A function that adds a picture `[height, width, 3]` uint8 to a film; the file is there when the block has ended.

    Args:
        path: One of `CODECS`.
        fps: Pictures a second.
        width: Pixels, even.
        height: Pixels, even.

    Raises:
        InputError: The codec is not in this OpenCV, or the file cannot be written.
    """
    count = 0
    with atomic_path(path) as temporary:
        temporary.touch()  # What the system says of the folder, it says here: OpenCV does not tell.
        codec = cv2.VideoWriter.fourcc(*CODECS[temporary.suffix.lower()])
        writer = cv2.VideoWriter(str(temporary), cv2.CAP_FFMPEG, codec, fps, (width, height))
        if not writer.isOpened():
            raise InputError(f"cannot write {path}: this OpenCV cannot encode VP9")

        def add(picture: np.ndarray) -> None:
            nonlocal count
            writer.write(np.ascontiguousarray(picture[..., ::-1]))
            count += 1

        try:
            yield add
        finally:
            writer.release()
        if _count_frames(temporary) != count:  # A full disk: OpenCV says nothing of it.
            raise InputError(f"cannot write {path}: not all of its {count} pictures are in it; is the disk full?")


def read_path(path: str | Path) -> Keyframes:
    """The flight that a JSON file tells, in the coordinates of the file.

    `{"closed": false, "keyframes": [{"viewmat": [[...], ...], "fov": 50.0}, ...]}`: 4x4 matrices by rows, world to
    camera, OpenCV axes, as `cameras.json` of a run has them; vertical angles of view in degrees.

    Raises:
        InputError: It cannot be read, has another shape, too few keyframes, or one that is no pose or no angle of view.
    """
    told = json_files.read(path, _SHAPE)
    closed, frames = told.get("closed", False), told["keyframes"]
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
