"""Text files of a COLMAP model: lines of words, comments behind a # (https://colmap.github.io/format.html).

Files of other programs may lack the keypoints behind an image; they may have spaces in names, or a byte order mark.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.colmap_records import CAMERA_MODELS, KEYPOINT, NO_POINT, ImageRecord, by_id, decode_text
from gsjax.io.files import read_bytes
from gsjax.io.lenses import Lens
from gsjax.scene.similarity import is_float32

_POINT = np.dtype([("id", "<i8"), ("xyz", "<f8", 3), ("color", "<f8", 3)])
_NO_KEYPOINTS = np.empty(0, KEYPOINT)


def count_images(file: Path) -> int:
    """How many images `images.txt` lists."""
    return sum(1 for _ in read_images(file))


def read_cameras(file: Path) -> dict[int, Lens]:
    """The cameras by their ids; their numbers are not checked."""
    return by_id(file, (_camera(file, number, line) for number, line in _lines(file) if line))


def read_points(file: Path) -> np.ndarray:
    """`[P]` structured array of `id`, `xyz` and `color`, the last as it is written: floats."""
    return np.fromiter((_point(file, number, line) for number, line in _lines(file) if line), _POINT)


def _lines(file: Path) -> Iterator[tuple[int, str]]:
    """Number and content of the lines that are no comments."""
    for number, line in enumerate(read_bytes(file).removeprefix(b"\xef\xbb\xbf").split(b"\n"), 1):
        if not line.startswith(b"#"):
            yield number, decode_text(line).strip()


def _camera(file: Path, number: int, line: str) -> tuple[int, Lens]:
    words = line.split()
    model = words[1].upper() if len(words) > 1 else ""
    if model not in CAMERA_MODELS:
        raise InputError(f"{file}: unknown camera model {' '.join(words[1:2])!r} of camera {words[0]}")
    try:
        camera, width, height, *params = int(words[0]), int(words[2]), int(words[3]), *map(float, words[4:])
    except (ValueError, IndexError):
        raise InputError(f"{file}, line {number}: is no camera") from None
    count = CAMERA_MODELS[model][1]
    if len(params) != count:
        raise InputError(f"{file}: camera {camera} has {len(params)} parameters, {model} takes {count}")
    return camera, Lens(model, width, height, tuple(params))


def read_images(file: Path) -> Iterator[ImageRecord]:
    """The images in the file's order. A line of keypoints may follow an image, and may be blank."""
    image = None
    for number, line in _lines(file):
        keypoints = None if image is None else _keypoints(line)
        if image is not None:
            yield image if keypoints is None else image._replace(keypoints=keypoints)
        image = _image(file, number, line) if keypoints is None and line else None
    if image is not None:
        yield image


def _image(file: Path, number: int, line: str) -> ImageRecord:
    words = line.split(maxsplit=9)
    try:
        int(words[0])
        return ImageRecord(words[9], list(map(float, words[1:8])), int(words[8]), _NO_KEYPOINTS)
    except (ValueError, IndexError):
        raise InputError(f"{file}, line {number}: is neither an image nor keypoints of one") from None


def _keypoints(line: str) -> np.ndarray | None:
    """The keypoints of a line, of three numbers each, the third an id; None where it is something else."""
    try:
        numbers = np.array(line.split(), np.float64).reshape(-1, 3)
    except ValueError:
        return None
    if (np.rint(numbers[:, 2]) != numbers[:, 2]).any():  # An image whose name is numbers.
        return None
    keypoints = np.empty(len(numbers), KEYPOINT)
    keypoints["xy"] = numbers[:, :2]
    is_id = np.abs(numbers[:, 2]) < 2.0**63  # 2^64 - 1 means no point, as -1 does.
    keypoints["point"] = np.where(is_id, numbers[:, 2], NO_POINT)
    return keypoints


def _point(file: Path, number: int, line: str) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    words = line.split(maxsplit=7)
    try:
        point, *numbers = int(words[0]), *map(float, words[1:7])
    except ValueError:
        point, numbers = 0, []
    if len(numbers) != 6 or not is_float32(np.array(numbers[3:])).all() or abs(point) >= 2**63:
        raise InputError(f"{file}, line {number}: is no point")
    return point, tuple(numbers[:3]), tuple(numbers[3:])
