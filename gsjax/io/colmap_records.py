"""What the files of a COLMAP model hold, binary or text alike, one record a camera, an image and a point."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsjax.errors import InputError
from gsjax.io.lenses import Lens

KEYPOINT = np.dtype([("xy", "<f8", 2), ("point", "<i8")])
NO_POINT = -1


class ImageRecord(NamedTuple):
    """An image as the file has it, not yet checked."""

    name: str
    pose: list[float]  # quaternion, w first, and translation: world to camera
    camera: int  # its id
    keypoints: np.ndarray  # [K] of KEYPOINT


CAMERA_MODELS = {
    "SIMPLE_PINHOLE": (0, 3),
    "PINHOLE": (1, 4),
    "SIMPLE_RADIAL": (2, 4),
    "RADIAL": (3, 5),
    "OPENCV": (4, 8),
    "OPENCV_FISHEYE": (5, 8),
    "FULL_OPENCV": (6, 12),
    "FOV": (7, 5),
    "SIMPLE_RADIAL_FISHEYE": (8, 4),
    "RADIAL_FISHEYE": (9, 5),
    "THIN_PRISM_FISHEYE": (10, 12),
    "RAD_TAN_THIN_PRISM_FISHEYE": (11, 16),
    "SIMPLE_DIVISION": (12, 4),
    "DIVISION": (13, 5),
    "SIMPLE_FISHEYE": (14, 3),
    "FISHEYE": (15, 4),
    "EUCM": (16, 6),
    "EQUIRECTANGULAR": (17, 2),
}
"""COLMAP's camera models (`colmap/sensor/models.h`): name -> number, count of parameters."""


def by_id(file: Path, cameras: Iterable[tuple[int, Lens]]) -> dict[int, Lens]:
    """The cameras of a file by their ids."""
    lenses: dict[int, Lens] = {}
    for camera, lens in cameras:
        if lenses.setdefault(camera, lens) != lens:
            raise InputError(f"{file}: camera {camera} is there twice, and not the same")
    return lenses


def decode_text(text: bytes) -> str:
    """UTF-8; or Latin-1, as older programs on Windows write it."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")
