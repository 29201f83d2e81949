"""Depth that was measured beside the photos, by LiDAR or a depth camera: maps, their unit and their confidence."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.arrays import headers, read_arrays
from gsjax.io.images import cv2, image_size, same_shape
from gsjax.io.json_shapes import check
from gsjax.io.normal_maps import map_places
from gsjax.scene import Frame

METRES = {"mm": 0.001, "cm": 0.01, "m": 1.0}
"""Of the units of length; the unit `scene` is that of the data set's own coordinates."""

UNITS = (*METRES, "scene")
UNIT_FILE = "depth.json"
CONFIDENCE = "confidence"  # The folder's name, beside that of the maps.
_SUFFIXES = (".png", ".npy")
_FULL, _LEVELS = 255, 2  # Confidence counts to 255; or, as ARKit has it, is 0, 1 or 2.

Readings = tuple[np.ndarray, np.ndarray]
"""Depth `[h, w]` float32 in the maps' unit, 0 where nothing was measured, and confidence `[h, w]` uint8 to 255."""


@dataclass(frozen=True)
class DepthMaps:
    """The maps of a folder. Each shows what its photo shows, distorted as it is, and may be of any size."""

    folder: Path
    unit: str  # of `UNITS`
    read: Mapping[str, Callable[[], Readings]]  # frame's name -> reads its map; frames without one are absent


def open_depth_maps(scene: str | Path, given: str, unit: str | None, frames: tuple[Frame, ...]) -> DepthMaps:
    """The depth maps of frames: `NAME.png` (16 bit) or `NAME.npy`, camera z, 0 or not finite where nothing is known.

    A map has its photo's name with the suffix in place of the photo's or after it. A folder `confidence` beside that of
    the maps may hold 8-bit PNGs of the same names: 0 to 255, or ARKit's levels 0, 1 and 2. Only headers are read now.

    Args:
        scene: Folder of the data set.
        given: Folder of the maps, in `scene` or anywhere.
        unit: Of `UNITS`; None: as `depth.json` in the folder says, `{"unit": "mm"}`.
        frames: Those that may have one.

    Raises:
        InputError: There is no such folder, no map of any frame or no unit; or a map is not of its frame's shape, or of
            no depth. Reading one raises it where what follows the header is damaged.
    """
    folder = next((place for place in (Path(scene) / given, Path(given)) if place.is_dir()), None)
    if folder is None:
        raise InputError(f"--depth {given}: no such folder of depth maps, in {scene} or here")
    places = map_places(frames)
    read = {}
    for frame in frames:
        if (file := _file(folder, str(places[frame.name]), frame.name)) is not None:
            _check_size(file, _size(file), frame)
            confidence = _confidence(folder, file, frame)
            read[frame.name] = partial(_read, file, confidence)
    if not read:
        raise InputError(f"{folder}: no depth map in it has the name of a photo, as {places[frames[0].name]}.png")
    return DepthMaps(folder, unit or _stated_unit(folder), read)


def on_grid(readings: Readings, frame: Frame, scale: int) -> Readings:
    """What was measured, at the pixels of a frame: `[H // scale, W // scale]`, 0 where nothing was.

    Nothing is interpolated, because between two surfaces there is none: of a map that is larger than the frame each
    pixel takes the nearest value; of a smaller one each value goes to the one pixel that holds it. Of a distorted photo
    each pixel of the frame takes the nearest value.

    Args:
        readings: Of any size, showing all that the photo shows.
        frame: The photo's.
        scale: The frame is reduced by this factor; a rest at the right and the bottom is dropped.
    """
    if frame.origin is not None:
        readings = _undistorted(readings, frame.origin.positions())
    (to_rows, rows), (to_columns, columns) = (
        _matches(*sides, scale) for sides in zip((frame.height, frame.width), readings[0].shape, strict=True)
    )
    placed = []
    for values in readings:
        grid = np.zeros((frame.height // scale, frame.width // scale), values.dtype)
        grid[to_rows[:, None], to_columns] = values[rows[:, None], columns]
        placed.append(grid)
    return placed[0], placed[1]


def _undistorted(readings: Readings, positions: np.ndarray) -> Readings:
    """At a frame's pixels, which lie at these shares `[H, W, 2]` of the photo's sides; -1 beyond the photo."""
    height, width = readings[0].shape
    x, y = np.moveaxis(positions, -1, 0)
    column, row = ((np.clip(at, 0, 1) * side).astype(int) for at, side in ((x, width), (y, height)))
    nearest = np.minimum(row, height - 1), np.minimum(column, width - 1)
    depth, trust = (np.where(x < 0, 0, values[nearest]).astype(values.dtype) for values in readings)
    return depth, trust


def _matches(side: int, length: int, scale: int) -> tuple[np.ndarray, np.ndarray]:
    """Along one axis: places in a frame of `side` pixels that is reduced, and those of the map that belong there."""
    count, share = side // scale, length * scale / side  # of the map's pixels to one of the frame's
    if share >= 1:
        places = np.arange(count)
        return places, np.minimum(((places + 0.5) * share).astype(int), length - 1)
    own = np.arange(length)
    places = ((own + 0.5) / share).astype(int)
    return places[places < count], own[places < count]


def _file(folder: Path, place: str, name: str) -> Path | None:
    candidates = [folder / f"{stem}{suffix}" for stem in (place, name) for suffix in _SUFFIXES]
    return next((file for file in candidates if file.is_file()), None)


def _stated_unit(folder: Path) -> str:
    file = folder / UNIT_FILE
    if not file.is_file():
        raise InputError(f"{folder}: the unit of its depth is not stated; --depth-unit mm, or {UNIT_FILE} in it")
    stated = json_files.read(file)
    check(file, stated, {"unit": set(UNITS)})
    return stated["unit"]


def _size(file: Path) -> tuple[int, int]:
    """Width and height of a map, from its header."""
    if file.suffix == ".png":
        return image_size(file)
    shape, dtype = headers(file)[""]
    if len(shape) != 2 or 0 in shape or dtype.kind not in "fu":
        raise InputError(f"{file}: an array of shape {list(shape)} and type {dtype}, not a depth map [H, W] of floats")
    return shape[1], shape[0]


def _check_size(file: Path, size: tuple[int, int], frame: Frame) -> None:
    width, height = (frame.width, frame.height) if frame.origin is None else frame.origin.photo
    if not same_shape(size, (width, height)):
        raise InputError(f"{file}: depth map is {size[0]}x{size[1]}, its photo {width}x{height}")


def _confidence(folder: Path, file: Path, frame: Frame) -> Path | None:
    confidence = (folder.parent / CONFIDENCE / file.relative_to(folder)).with_suffix(".png")
    if not confidence.is_file():
        return None
    _check_size(confidence, image_size(confidence), frame)
    return confidence


def _read(file: Path, confidence: Path | None) -> Readings:
    raw = _pixels(file) if file.suffix == ".png" else read_arrays(file)[""]
    if file.suffix == ".png" and raw.dtype != np.uint16:
        raise InputError(f"{file}: a picture of {8 * raw.dtype.itemsize} bits; a depth map has 16")
    with np.errstate(over="ignore"):  # Of doubles beyond float32: infinite, and so unknown.
        depth = raw.astype(np.float32)
    depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
    trust = np.full(depth.shape, _FULL, np.uint8) if confidence is None else _trust(confidence, depth.shape)
    return depth, np.where(depth > 0, trust, np.uint8(0))


def _trust(file: Path, shape: tuple[int, int]) -> np.ndarray:
    levels = _pixels(file)
    if levels.dtype != np.uint8 or levels.shape != shape:
        raise InputError(f"{file}: confidence is {levels.shape[1]}x{levels.shape[0]} of {levels.dtype}, its depth map"
            f" {shape[1]}x{shape[0]}; it must be of that size, of 8 bits")  # fmt: skip
    return levels if levels.max() > _LEVELS else (levels.astype(int) * _FULL // _LEVELS).astype(np.uint8)


def _pixels(file: Path) -> np.ndarray:
    """`[H, W]` as a PNG has them."""
    pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.ndim != 2:
        raise InputError(f"{file}: not a whole picture of one channel")
    return pixels
