"""Files of a COLMAP model (https://colmap.github.io/format.html): cameras, images and points, binary or text.

Binary files hold a count, then that many records. Text has lines of words, and comments behind a #. Text of other
programs may lack the keypoints behind an image; it may have spaces in names, or a byte order mark.
"""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from gsjax.errors import InputError
from gsjax.io.files import read_bytes
from gsjax.io.lenses import Lens
from gsjax.scene.similarity import is_float32

KEYPOINT = np.dtype([("xy", "<f8", 2), ("point", "<i8")])  # -1: no point
_COUNT, _CAMERA, _IMAGE = struct.Struct("<Q"), struct.Struct("<IiQQ"), struct.Struct("<I7dI")
_BINARY_POINT = np.dtype([("id", "<i8"), ("xyz", "<f8", 3), ("color", "u1", 3)])
_TEXT_POINT = np.dtype([("id", "<i8"), ("xyz", "<f8", 3), ("color", "<f8", 3)])
_CAMERA_MODELS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
    "FOV": 5,
    "SIMPLE_RADIAL_FISHEYE": 4,
    "RADIAL_FISHEYE": 5,
    "THIN_PRISM_FISHEYE": 12,
    "RAD_TAN_THIN_PRISM_FISHEYE": 16,
    "SIMPLE_DIVISION": 4,
    "DIVISION": 5,
    "SIMPLE_FISHEYE": 3,
    "FISHEYE": 4,
    "EUCM": 6,
    "EQUIRECTANGULAR": 2,
}
"""COLMAP's camera models in the order of their numbers (`colmap/sensor/models.h`): name -> count of parameters."""

Record = TypeVar("Record")


class PosedImage(NamedTuple):
    """A photo as the file has it; its pose is not checked."""

    name: str
    pose: list[float]  # quaternion, w first, and translation: world to camera
    camera: int  # its id
    keypoints: np.ndarray  # [K] of KEYPOINT

    @property
    def viewmat(self) -> np.ndarray:
        """`[4, 4]` float64 rigid, world to camera; the quaternion is made unit."""
        viewmat = np.eye(4)
        viewmat[:3, :3] = Rotation.from_quat(self.pose[:4], scalar_first=True).as_matrix()
        viewmat[:3, 3] = self.pose[4:]
        return viewmat


def count_images(file: Path) -> int:
    """How many images a file lists; of a binary one, how many it promises, of those that have room in it."""
    if file.suffix == ".txt":
        return sum(1 for _ in read_images(file))
    with file.open("rb") as stream:
        head = stream.read(_COUNT.size)
    room = file.stat().st_size // (_IMAGE.size + _COUNT.size)
    return min(_COUNT.unpack(head)[0], room) if len(head) == _COUNT.size else 0


def read_cameras(file: Path) -> dict[int, Lens]:
    """The cameras by their ids; their numbers are not checked."""
    cameras = _parsed_lines(file, "camera", _camera_in) if file.suffix == ".txt" else _records(file, _camera_at)
    lenses: dict[int, Lens] = {}
    for camera, lens in cameras:
        if lenses.setdefault(camera, lens) != lens:
            raise InputError(f"{file}: camera {camera} is there twice, and not the same")
    return lenses


def read_images(file: Path) -> Iterator[PosedImage]:
    """The images in the file's order."""
    return _images_in(file) if file.suffix == ".txt" else _records(file, _image_at)


def read_points(file: Path) -> np.ndarray:
    """`[P]` structured array of `id`, `xyz` and `color`, the last of text as it is written: floats."""
    if file.suffix == ".txt":
        return np.fromiter(_parsed_lines(file, "point", _point_in), _TEXT_POINT)
    return np.frombuffer(b"".join(_records(file, _point_at)), _BINARY_POINT)


def _records(file: Path, record_at: Callable[[bytes, int], tuple[Record, int]]) -> Iterator[Record]:
    """The records of a file. `record_at` gives the one that begins at a byte, and the byte after it.

    Whatever the bytes say, it ends: at the last record that is promised, or at the end of the file, with an error.
    """
    data = read_bytes(file)
    at = _COUNT.size
    try:
        (count,) = _COUNT.unpack_from(data, 0)
        for _ in range(count):
            record, at = record_at(data, at)
            if at > len(data):
                raise struct.error
            yield record
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    except (struct.error, ValueError):
        raise InputError(f"{file}: truncated, the records it promises do not fit its {len(data)} bytes") from None
    if at < len(data):
        raise InputError(f"{file}: damaged, it holds more than the {count} records that it promises")


def _camera_at(data: bytes, at: int) -> tuple[tuple[int, Lens], int]:
    camera, number, width, height = _CAMERA.unpack_from(data, at)
    if not 0 <= number < len(_CAMERA_MODELS):
        raise InputError(f"unknown camera model {number} of camera {camera}")
    model, count = list(_CAMERA_MODELS.items())[number]
    params = struct.unpack_from(f"<{count}d", data, at + _CAMERA.size)
    return (camera, Lens(model, width, height, params)), at + _CAMERA.size + 8 * count


def _image_at(data: bytes, at: int) -> tuple[PosedImage, int]:
    """Numbers, a name ended by a zero, a count, and keypoints."""
    _, *pose, camera = _IMAGE.unpack_from(data, at)
    end = data.index(0, at + _IMAGE.size)
    (count,) = _COUNT.unpack_from(data, end + 1)
    start = end + 1 + _COUNT.size
    after = start + KEYPOINT.itemsize * count
    if after > len(data):
        raise struct.error
    name = _decode(data[at + _IMAGE.size : end])
    return PosedImage(name, pose, camera, np.frombuffer(data, KEYPOINT, count, start)), after


def _point_at(data: bytes, at: int) -> tuple[bytes, int]:
    """The point's own bytes; behind them its error (8 bytes), a count, and 8 bytes for each element of its track."""
    (track,) = _COUNT.unpack_from(data, at + _BINARY_POINT.itemsize + 8)
    return data[at : at + _BINARY_POINT.itemsize], at + _BINARY_POINT.itemsize + 8 + _COUNT.size + 8 * track


def _decode(text: bytes) -> str:
    """UTF-8; or Latin-1, as older programs on Windows write it."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")


def _lines(file: Path) -> Iterator[tuple[int, str]]:
    """Number and content of the lines that are no comments."""
    for number, line in enumerate(read_bytes(file).removeprefix(b"\xef\xbb\xbf").split(b"\n"), 1):
        if not line.startswith(b"#"):
            yield number, _decode(line).strip()


def _parsed_lines(file: Path, kind: str, parse: Callable[[str], Record]) -> Iterator[Record]:
    """What `parse` makes of each line that is not blank; InputError, which names the line, where it is no record."""
    for number, line in _lines(file):
        try:
            if line:
                yield parse(line)
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
        except ValueError:
            raise InputError(f"{file}, line {number}: is no {kind}") from None


def _camera_in(line: str) -> tuple[int, Lens]:
    camera, name, *numbers = line.split()
    model = name.upper()
    if model not in _CAMERA_MODELS:
        raise InputError(f"unknown camera model {name!r} of camera {camera}")
    width, height, *params = numbers
    if len(params) != _CAMERA_MODELS[model]:
        raise InputError(f"camera {camera} has {len(params)} parameters, {model} takes {_CAMERA_MODELS[model]}")
    return int(camera), Lens(model, int(width), int(height), tuple(map(float, params)))


def _images_in(file: Path) -> Iterator[PosedImage]:
    """A line of keypoints may follow an image, and may be blank."""
    image = None
    for number, line in _lines(file):
        keypoints = None if image is None else _keypoints_in(line)
        if image is not None:
            yield image if keypoints is None else image._replace(keypoints=keypoints)
        image = _image_in(file, number, line) if keypoints is None and line else None
    if image is not None:
        yield image


def _image_in(file: Path, number: int, line: str) -> PosedImage:
    words = line.split(maxsplit=9)
    try:
        int(words[0])
        return PosedImage(words[9], list(map(float, words[1:8])), int(words[8]), np.empty(0, KEYPOINT))
    except (ValueError, IndexError):
        raise InputError(f"{file}, line {number}: is neither an image nor keypoints of one") from None


def _keypoints_in(line: str) -> np.ndarray | None:
    """The keypoints of a line, of three numbers each, the third an id; None where it is something else."""
    try:
        numbers = np.array(line.split(), np.float64).reshape(-1, 3)
    except ValueError:
        return None
    if (np.rint(numbers[:, 2]) != numbers[:, 2]).any():  # An image whose name is numbers.
        return None
    keypoints = np.empty(len(numbers), KEYPOINT)
    keypoints["xy"] = numbers[:, :2]
    keypoints["point"] = np.where(np.abs(numbers[:, 2]) < 2.0**63, numbers[:, 2], -1)  # 2^64 - 1 means no point too.
    return keypoints


def _point_in(line: str) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    point, *numbers = line.split(maxsplit=7)[:7]
    x, y, z, *color = map(float, numbers)
    if len(color) != 3 or not is_float32(np.array(color)).all() or abs(int(point)) >= 2**63:
        raise ValueError
    return int(point), (x, y, z), tuple(color)
