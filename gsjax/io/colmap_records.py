"""What the files of a COLMAP model hold, binary or text alike, one record a camera, an image and a point."""

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsjax.errors import InputError
from gsjax.io.lenses import Lens
from gsjax.io.packages import require

KEYPOINT = np.dtype([("xy", "<f8", 2), ("point", "<i8")])
NO_POINT = -1


class ImageRecord(NamedTuple):
    """An image as the file has it, not yet checked."""

    name: str
    pose: list[float]  # quaternion, w first, and translation: world to camera
    camera: int  # its id
    keypoints: np.ndarray  # [K] of KEYPOINT


@cache
def camera_models() -> dict[str, tuple[int, int]]:
    """The camera models that COLMAP knows: name -> number and count of parameters."""
    pycolmap = require("pycolmap", "pip install pycolmap")
    known = {name: int(model) for name, model in pycolmap.CameraModelId.__members__.items() if name != "INVALID"}
    counts = {name: len(pycolmap.Camera.create_from_model_name(0, name, 1.0, 1, 1).params) for name in known}
    return {name: (known[name], counts[name]) for name in known}


def by_id(file: Path, cameras: Iterable[tuple[int, Lens]]) -> dict[int, Lens]:
    """The cameras of a file by their ids.

    Raises:
        InputError: Two that differ have one id.
    """
    found: dict[int, Lens] = {}
    for camera, lens in cameras:
        if found.setdefault(camera, lens) != lens:
            raise InputError(f"{file}: camera {camera} is there twice, and not the same")
    return found


def decode_text(text: bytes) -> str:
    """UTF-8; or Latin-1, as older programs on Windows write it."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")
