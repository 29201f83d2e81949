"""The direction of gravity in a photo, as its device recorded it: an iPhone's accelerometer, a drone's gimbal.

Apple's maker note keeps under tag 8 the vector that CoreMotion calls acceleration, in units of g: at rest it points
down, in the axes of the phone: x right, y to its top, z out of the screen. Its camera looks along -z, and the sensor's
rows run from the phone's top to its bottom. (ExifTool's table of Apple's tags names the opposite axes.) DJI's XMP has
the gimbal's pitch (0 level, -90 straight down) and roll, degrees.
"""

import math
import re
from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any, NamedTuple

import numpy as np
from PIL.TiffImagePlugin import ImageFileDirectory_v2

MAKER_NOTE = 0x927C
_APPLE, _ACCELERATION = b"Apple iOS\0", 0x0008
_TIFF_HEADERS = {b"MM": b"MM\0*\0\0\0\0", b"II": b"II*\0\0\0\0\0"}  # by their byte order
_FRONT_LENS = 0xA434  # the tag of a lens' name, in which Apple says "front camera"
_STILL = 0.1  # of g: a larger difference is acceleration of the hand
_FLAT = 0.5  # of g along the picture: with less, its lower edge is undetermined
_GIMBAL = {
    name: re.compile(rf"Gimbal{name}Degree\s*(?:=\s*[\"']|>)\s*([+-]?\d+(?:\.\d+)?)") for name in ("Pitch", "Roll")
}
FEWEST = 3  # photos with gravity
_LARGEST_MEDIAN = math.radians(10.0)  # of the angles between their directions and the median direction
_FAR = 3.0  # times that median: photos beyond are outliers

Vector = tuple[float, float, float]


class Up(NamedTuple):
    """The direction up in a model."""

    direction: np.ndarray  # [3] unit
    error: float  # its standard error, radians
    source: str  # of the direction, in words


def read_gravity(details: Mapping[int, Any], xmp: Any) -> Vector | None:
    """Read the unit vector down, in the axes of the upright photo: x right, y down, z forward; None: unknown.

    It is in EXIF's table of details, or in XMP, which is text, bytes or None.
    """
    note = details.get(MAKER_NOTE)
    is_front = "front" in str(details.get(_FRONT_LENS, "")).lower()  # whose pictures may be mirrored
    if isinstance(note, bytes) and note.startswith(_APPLE) and not is_front:
        measured = _acceleration(note)
        return None if measured is None else _of_phone(*measured)
    return _of_gimbal(xmp.decode("utf-8", "replace") if isinstance(xmp, bytes) else str(xmp or ""))


def up_by_gravity(viewmats: np.ndarray, gravities: Sequence[Vector | None]) -> Up | None:
    """Estimate the direction up from most photos; None where they are too few, or inconsistent.

    Viewmats `[V, 3, 4]` are world to camera, of the upright photos; each has its `read_gravity`.
    """
    pairs = [(pose[:, :3], down) for pose, down in zip(viewmats, gravities, strict=True) if down is not None]
    if len(pairs) < FEWEST:
        return None
    ups = np.stack([-np.array(down) @ rotation for rotation, down in pairs])
    up = np.median(ups, axis=0)
    if not np.linalg.norm(up) > 0:
        return None
    off = _angles(ups, up)
    if np.median(off) > _LARGEST_MEDIAN:
        return None
    inliers = off <= _FAR * max(float(np.median(off)), 1e-6)
    up = ups[inliers].mean(axis=0)
    error = float(np.sqrt((_angles(ups[inliers], up) ** 2).mean() / inliers.sum()))
    return Up(up / np.linalg.norm(up), error, f"the gravity that {inliers.sum()} photos noted")


def _angles(vectors: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.arccos(np.clip(vectors @ other / np.linalg.norm(other), -1, 1))


def _of_phone(x: float, y: float, z: float) -> Vector | None:
    """Convert an accelerometer's vector. The upright picture is on its lowest edge."""
    size = math.sqrt(x * x + y * y + z * z)
    along = math.hypot(x, y)
    if not abs(size - 1) <= _STILL or along < _FLAT:
        return None
    # In the sensor's frame it is (-y, -x, -z). A picture is on its lower edge, so within 45 degrees down is down.
    right, down = -y, -x
    for _ in range(4):
        if down >= abs(right):
            return right / size, down / size, -z / size
        right, down = -down, right
    return None


def _of_gimbal(xmp: str) -> Vector | None:
    pitch, roll = (pattern.search(xmp) for pattern in _GIMBAL.values())
    if pitch is None:
        return None
    pitch, roll = (math.radians(float(match[1])) if match else 0.0 for match in (pitch, roll))
    return math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll), -math.sin(pitch)


def _acceleration(note: bytes) -> Vector | None:
    """Read the three fractions in Apple's maker note, whose table follows its name, version and byte order."""
    try:
        table, content = ImageFileDirectory_v2(_TIFF_HEADERS[note[12:14]]), BytesIO(note)
        content.seek(14)
        table.load(content)
        x, y, z = map(float, table[_ACCELERATION])
    except Exception:  # Pillow's many ways to say "damaged".
        return None
    return x, y, z
