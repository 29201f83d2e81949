"""Binary files of a COLMAP model: a count, then that many records (https://colmap.github.io/format.html)."""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import numpy as np

from gsjax.errors import InputError
from gsjax.io.colmap_records import CAMERA_MODELS, KEYPOINT, ImageRecord, by_id, decode_text
from gsjax.io.files import read_bytes
from gsjax.io.lenses import Lens

_COUNT, _CAMERA, _IMAGE = struct.Struct("<Q"), struct.Struct("<IiQQ"), struct.Struct("<I7dI")
_POINT = np.dtype([("id", "<i8"), ("xyz", "<f8", 3), ("color", "u1", 3)])

Record = TypeVar("Record")


def count_images(file: Path) -> int:
    """How many images `images.bin` promises, of those that have room in it."""
    with file.open("rb") as stream:
        head = stream.read(_COUNT.size)
    room = file.stat().st_size // (_IMAGE.size + _COUNT.size)
    return min(_COUNT.unpack(head)[0], room) if len(head) == _COUNT.size else 0


def read_cameras(file: Path) -> dict[int, Lens]:
    """The cameras by their ids; their numbers are not checked."""
    return by_id(file, _records(file, _camera_at))


def read_images(file: Path) -> Iterator[ImageRecord]:
    """The images in the file's order."""
    return _records(file, _image_at)


def read_points(file: Path) -> np.ndarray:
    """`[P]` structured array of `id`, `xyz` and `color`."""
    return np.frombuffer(b"".join(_records(file, _point_at)), _POINT)


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
    model = next((name for name, (model_id, _) in CAMERA_MODELS.items() if model_id == number), None)
    if model is None:
        raise InputError(f"unknown camera model {number} of camera {camera}")
    count = CAMERA_MODELS[model][1]
    params = struct.unpack_from(f"<{count}d", data, at + _CAMERA.size)
    return (camera, Lens(model, width, height, params)), at + _CAMERA.size + 8 * count


def _image_at(data: bytes, at: int) -> tuple[ImageRecord, int]:
    """Numbers, a name ended by a zero, a count, and keypoints."""
    _, *pose, camera = _IMAGE.unpack_from(data, at)
    end = data.index(0, at + _IMAGE.size)
    (count,) = _COUNT.unpack_from(data, end + 1)
    start = end + 1 + _COUNT.size
    after = start + KEYPOINT.itemsize * count
    if after > len(data):
        raise struct.error
    name = decode_text(data[at + _IMAGE.size : end])
    return ImageRecord(name, pose, camera, np.frombuffer(data, KEYPOINT, count, start)), after


def _point_at(data: bytes, at: int) -> tuple[bytes, int]:
    """The point's own bytes; behind them its error (8 bytes), a count, and 8 bytes for each element of its track."""
    (track,) = _COUNT.unpack_from(data, at + _POINT.itemsize + 8)
    return data[at : at + _POINT.itemsize], at + _POINT.itemsize + 8 + _COUNT.size + 8 * track
