"""Depth that was measured with the photos, by LiDAR or a depth camera: maps, their unit and their confidence."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.arrays import headers, read_arrays
from gsjax.io.bad_items import leave_out, read_usable
from gsjax.io.depth_windows import Window, on_grid, window_of
from gsjax.io.image_folders import files_of_photos
from gsjax.io.images import cv2, image_size
from gsjax.io.normal_maps import map_places
from gsjax.scene import DepthFile, Frame

METRES = {"mm": 0.001, "cm": 0.01, "m": 1.0}
"""Of the units of length; the unit `scene` is that of the data set's own coordinates."""

UNITS = (*METRES, "scene")
AUTO, USUAL_FOLDER = "auto", "depth"
UNIT_FILE = "depth.json"
CONFIDENCE = "confidence"  # The folder's name, beside that of the maps.
_STATED = {"unit?": set(UNITS), "intrinsics?": [[float, 3], 3]}  # in `depth.json`
_SUFFIXES = (".png", ".npy")
_FULL, _LEVELS = 255, 2  # Confidence counts to 255; or, as ARKit has it, is 0, 1 or 2.

Readings = tuple[np.ndarray, np.ndarray]
"""Depth `[h, w]` float32 in the maps' unit, 0 where nothing was measured, and confidence `[h, w]` uint8 to 255."""


@dataclass(frozen=True)
class DepthMaps:
    """Maps by the frame's name; frames without one are absent. A map may be of any size."""

    folder: Path
    unit: str  # as messages call it
    metres: float | None  # in a unit; None: it is that of the data set's own coordinates
    read: Mapping[str, Callable[[], Readings]]
    windows: Mapping[str, Window]  # which part of a map shows what its photo shows
    note: str  # how maps of another shape than their photos are read, or ""

    def at(self, frame: Frame, scale: int) -> Readings:
        """The map of a frame at the frame's pixels, see `on_grid`."""
        return on_grid(self.read[frame.name](), frame, scale, self.windows[frame.name])


def open_depth_maps(scene: str | Path, source: str, unit: str | None, frames: tuple[Frame, ...]) -> DepthMaps:
    """The depth maps of frames: `NAME.png` (16 bit) or `NAME.npy`, camera z, 0 or not finite where nothing is known.

    A map has its photo's name with the suffix in place of the photo's or after it. A folder `confidence` next to that
    of the maps may hold 8-bit PNGs of the same names: 0 to 255, or ARKit's levels 0, 1 and 2. Each map is read
    once now. Maps that cannot be used are left out and named (`gsjax.io.bad_items`).

    Args:
        scene: Folder of the data set.
        source: Folder of the maps, in `scene` or anywhere; or "auto": the maps that the data set lists, or else those
            of its folder `depth`.
        unit: Of `UNITS`; None: as `depth.json` in the folder says, `{"unit": "mm"}`, or as the data set lists it.
        frames: Those that may have one.

    Raises:
        InputError: There is no such folder, no map of any frame or no unit; or less than half of the maps are whole, of
            depth, and of the view of their photo.
    """
    listed = {frame.name: frame.depth for frame in frames if frame.depth is not None}
    if source == AUTO and listed:
        return _listed_maps(listed, unit, frames)
    source = USUAL_FOLDER if source == AUTO else source
    folder = next((place for place in (Path(scene) / source, Path(source)) if place.is_dir()), None)
    if folder is None:
        raise InputError(f"depth={source}: no such folder of depth maps, in {scene} or here")
    existing_files = files_of_photos(folder, (frame.name for frame in frames), _SUFFIXES)
    if not existing_files:
        raise InputError(
            f"{folder}: no depth map in it has the name of a photo, as {map_places(frames)[frames[0].name]}.png"
        )
    unit = unit or _depth_json(folder).get("unit")
    if unit is None:
        raise InputError(f"{folder}: its unit of depth is not stated; set supervision.depth_unit, or {UNIT_FILE} in it")
    return _opened(folder, existing_files, unit, METRES.get(unit), frames)


def _listed_maps(listed: Mapping[str, DepthFile], unit: str | None, frames: tuple[Frame, ...]) -> DepthMaps:
    existing_files = {name: depth.path for name, depth in listed.items() if depth.path.is_file()}
    first = next(iter(listed.values()))
    if not existing_files:
        raise InputError(f"{first.path}: no such depth map, nor another that the data set lists")
    folder = next(iter(existing_files.values())).parent
    if unit is not None:
        return _opened(folder, existing_files, unit, METRES.get(unit), frames)
    metres, *others = {listed[name].metres for name in existing_files}
    if others:
        raise InputError(f"{first.path.parent}: its maps are listed in several units; set supervision.depth_unit")
    if not 0 < metres < math.inf:
        raise InputError(f"{folder}: its maps are listed with a depth_unit_scale_factor that is no number above 0")
    names = {length: name for name, length in METRES.items()}
    return _opened(folder, existing_files, names.get(metres, f"units of {metres:g} m"), metres, frames)


def _opened(
    folder: Path, files: Mapping[str, Path], unit: str, metres: float | None, frames: tuple[Frame, ...]
) -> DepthMaps:
    """The maps of these files, which are in `folder` or, where the data set lists them, anywhere."""
    intrinsics = _intrinsics(folder)

    def usable(frame: Frame) -> tuple[Window, str, Callable[[], Readings]]:
        file = files[frame.name]
        read = partial(_read, file, _confidence(folder, file))
        window, note = window_of(file, _size(file), frame, intrinsics)
        read()  # What is damaged is found here, and not while training.
        return window, note, read

    measured = [frame for frame in frames if frame.name in files]
    maps, faults = read_usable(measured, lambda frame: frame.name, lambda frame: (frame.name, usable(frame)))
    leave_out("depth maps", faults, len(measured), needed=(len(measured) + 1) // 2)
    notes = list(dict.fromkeys(note for _, (_, note, _) in maps if note))
    more = f" (and {len(notes) - 1} other sizes)" if len(notes) > 1 else ""
    read = {name: read for name, (_, _, read) in maps}
    windows = {name: window for name, (window, _, _) in maps}
    return DepthMaps(folder, unit, metres, read, windows, f"{notes[0]}{more}" if notes else "")


def _depth_json(folder: Path) -> dict[str, Any]:
    """What `depth.json` next to the maps says."""
    file = folder / UNIT_FILE
    return json_files.read(file, _STATED) if file.is_file() else {}


def _intrinsics(folder: Path) -> np.ndarray | None:
    """`[3, 3]` of the camera that measured depth, pixels of the maps; None where they are not stated."""
    if "intrinsics" not in (record := _depth_json(folder)):
        return None
    K = np.array(record["intrinsics"], np.float64)
    if not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0 and K[2].tolist() == [0, 0, 1]):
        raise InputError(f"{folder / UNIT_FILE}: intrinsics are no matrix fx, 0, cx; 0, fy, cy; 0, 0, 1 of pixels")
    return K


def _size(file: Path) -> tuple[int, int]:
    """Width and height of a map, from its header."""
    if file.suffix == ".png":
        return image_size(file)
    shape, dtype = headers(file)[""]
    if len(shape) != 2 or 0 in shape or dtype.kind not in "fu":
        raise InputError(f"{file}: an array of shape {list(shape)} and type {dtype}, not a depth map [H, W] of floats")
    return shape[1], shape[0]


def _confidence(folder: Path, file: Path) -> Path | None:
    """The file of a map's confidence; None where there is none."""
    root = folder if file.is_relative_to(folder) else file.parent
    confidence = (root.parent / CONFIDENCE / file.relative_to(root)).with_suffix(".png")
    return confidence if confidence.is_file() else None


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
