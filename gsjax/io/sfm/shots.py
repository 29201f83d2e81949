"""Photos in a folder: which camera took each, and how it was held.

Structure from motion works in the sensor's frame, which is broader than high however the camera was held: so photos of
one camera share their intrinsics. What is written at the end is upright.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.images import Image, image_size, read_image

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp")

_MAKE, _MODEL, _ORIENTATION, _DETAILS, _FOCAL, _FOCAL_35 = 0x010F, 0x0110, 0x0112, 0x8769, 0x920A, 0xA405
# EXIF orientation: whether the stored columns run backwards, then quarter turns clockwise until upright.
_ORIENTATIONS = {1: (0, 0), 2: (1, 0), 3: (0, 2), 4: (1, 2), 5: (1, 3), 6: (0, 1), 7: (1, 1), 8: (0, 3)}


@dataclass(frozen=True)
class Shot:
    """One photo, not yet read."""

    name: str  # relative to the folder
    path: Path
    camera: tuple  # equal for the photos of one camera: make, model, focal lengths, width, height of the sensor
    mirrored: bool  # the stored columns run backwards
    to_sensor: int  # quarter turns anticlockwise, from the stored pixels to the sensor's frame
    to_upright: int  # quarter turns clockwise, from the sensor's frame to upright

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in the sensor's frame, pixels; width is never the smaller."""
        return self.camera[-2:]

    def read(self) -> np.ndarray:
        """`[H, W, 3]` uint8 in the sensor's frame.

        Raises:
            InputError: The file is damaged.
        """
        colors, _ = read_image(self.path)
        return np.ascontiguousarray(np.rot90(colors[:, ::-1] if self.mirrored else colors, self.to_sensor))

    def upright(self, colors: np.ndarray) -> np.ndarray:
        """Pixels `[H, W, ...]` of the sensor's frame, turned as the photo is looked at."""
        return np.rot90(colors, -self.to_upright)


def list_shots(folder: Path) -> list[Shot]:
    """The photos of a folder and its subfolders, by name.

    Raises:
        InputError: No folder, fewer than two photos, or one that is no image (named).
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of photos")
    files = sorted(f for f in folder.rglob("*") if f.suffix.lower() in PHOTO_SUFFIXES and not f.name.startswith("."))
    if len(files) < 2:
        raise InputError(f"{folder}: needs at least 2 photos ({', '.join(PHOTO_SUFFIXES)}), has {len(files)}")
    return [_shot(file, file.relative_to(folder).as_posix()) for file in files]


def turned_pose(pose: np.ndarray, turns: int) -> np.ndarray:
    """A pose `[3, 4]` (world to camera) after its picture was turned clockwise by quarter turns."""
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    return np.linalg.matrix_power(quarter, turns) @ pose


def turned_points(xy: np.ndarray, width: float, height: float, turns: int) -> np.ndarray:
    """Pixels `[N, 2]` of a picture of the given size after it was turned clockwise by quarter turns."""
    for _ in range(turns):
        xy, width, height = np.stack([height - xy[:, 1], xy[:, 0]], axis=-1), height, width
    return xy


def turned_pinhole(
    K: np.ndarray, width: int, height: int, turns: int
) -> tuple[tuple[float, float, float, float], int, int]:
    """COLMAP's PINHOLE parameters (fx, fy, cx, cy), width and height after quarter turns clockwise."""
    fx, fy = (K[0, 0], K[1, 1]) if turns % 2 == 0 else (K[1, 1], K[0, 0])
    ((cx, cy),) = turned_points(K[None, :2, 2], width, height, turns)
    return (fx, fy, cx, cy), *((width, height) if turns % 2 == 0 else (height, width))


def _shot(path: Path, name: str) -> Shot:
    width, height = image_size(path)
    make, model, focal, orientation = _exif(path)
    mirrored, turns = _ORIENTATIONS.get(orientation, (0, 0))
    standing = int(height > width)
    camera = (make, model, focal, max(width, height), min(width, height))
    return Shot(name, path, camera, bool(mirrored), standing, (turns + standing) % 4)


def _exif(path: Path) -> tuple[str, str, str, int]:
    """Make, model, focal lengths and orientation; empty, and 1, where the file does not say."""
    with Image.open(path) as picture:
        try:
            tags = picture.getexif()
            details = tags.get_ifd(_DETAILS)
        except (OSError, ValueError, SyntaxError, KeyError, TypeError):  # Pillow's many ways to say "damaged".
            return "", "", "", 1
    focal = f"{details.get(_FOCAL, '')} {details.get(_FOCAL_35, '')}"
    return str(tags.get(_MAKE, "")), str(tags.get(_MODEL, "")), focal, tags.get(_ORIENTATION, 1)
