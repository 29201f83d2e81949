"""Normal maps from a folder, as any network may have written them."""

import os
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np

from gsjax.errors import InputError
from gsjax.io.arrays import headers, read_arrays
from gsjax.io.bad_items import leave_out, read_usable
from gsjax.io.image_folders import files_of_photos
from gsjax.io.images import cv2, image_size, same_shape
from gsjax.io.normal_folders import is_recorded
from gsjax.io.photo_names import path_inside
from gsjax.io.photos import scaled_size
from gsjax.scene import Frame, Origin

_SUFFIXES = (".npy", ".npz", ".png")
_ASPECT_TOLERANCE = 0.02
_LONGEST = 1e15  # of a vector that is still taken for one: its square is finite in float32
_REDUCTIONS = range(1, 17)  # Whole factors by which a map may be smaller and its size still tells what it shows.


def normal_maps(directory: str | Path, frames: tuple[Frame, ...]) -> dict[str, Callable[[], np.ndarray]]:
    """Readers of the frames' normal maps, each resampled for its frame: one map at a time is in memory.

    Each map is read once now. Maps that are missing, damaged, not finite or of another view are left out and named
    (`gsjax.io.bad_items`): their frames have a map that says nothing.

    A map has its frame's name with the suffix `.npy`, `.npz` (the array `cam`, or the only one) or `.png` (8 or 16
    bit, n = 2v - 1), in place of the photo's or after it, in the same subfolder or in `directory` itself. Arrays are
    [H, W, 3] or [3, H, W]. Axes are the camera's: x right, y down, z forward.

    A map of a distorted photo is undistorted with it, a map of the undistorted frame is taken as it is. The size shows
    which: that of the photo or of the frame, or of either reduced by a whole factor, or else of one's shape
    (`gsjax.io.images.same_shape`) and not of the other's. Where both have one size, the map is the photo's. Maps that
    `gsjax normals` made are always of the undistorted frame (`gsjax.io.normal_folders`).

    Returns:
        Frame name -> function that reads [H, W, 3] float32, unit length, exactly zero where the map says nothing.

    Raises:
        InputError: There is no such folder, or less than half of the maps can be used.
    """
    directory = Path(directory)
    if not os.path.isdir(directory):
        raise InputError(f"{directory}: no such folder of normal maps")
    files = files_of_photos(directory, (frame.name for frame in frames), _SUFFIXES)
    undistorted = is_recorded(directory)

    def usable_reader(frame: Frame) -> Callable[[], np.ndarray]:
        if frame.name not in files:
            raise InputError(f"{directory}: no normal map of {frame.name}")
        read = _reader(files[frame.name], frame, undistorted)
        read()
        return read

    readers, faults = read_usable(frames, lambda frame: frame.name, lambda frame: (frame.name, usable_reader(frame)))
    leave_out("normal maps", faults, len(frames), needed=(len(frames) + 1) // 2)
    nothing = {frame.name: partial(np.zeros, (frame.height, frame.width, 3), np.float32) for frame in frames}
    return nothing | dict(readers)


def map_places(frames: Sequence[Frame]) -> dict[str, PurePosixPath]:
    """Each frame's name as a path without a suffix, within a folder; with it where two frames differ by theirs alone.

    Parts that would lead out of the folder are left out.
    """
    inside = {frame.name: path_inside(frame.name) for frame in frames}
    shared = Counter(path.with_suffix("") for path in inside.values())
    return {name: path if shared[path.with_suffix("")] > 1 else path.with_suffix("") for name, path in inside.items()}


def resize_normals(unit: np.ndarray, width: int, height: int) -> np.ndarray:
    """A map `[h, w, 3]` of unit vectors at another size: unit again, and zero where the nearest vector is."""
    unit = _shrunk(unit, width, height)
    if unit.shape[:2] == (height, width):
        return unit
    mixed = cv2.resize(unit, (width, height), interpolation=cv2.INTER_LINEAR)
    return _unit_where_known(mixed, cv2.resize(unit, (width, height), interpolation=cv2.INTER_NEAREST))


def _reader(file: Path, frame: Frame, undistorted: bool) -> Callable[[], np.ndarray]:
    size, origin = _size(file), None if undistorted else frame.origin
    if origin is not None and _shows_photo(file, size, frame, origin):
        return partial(_read_undistorted, file, frame, origin)
    if origin is None and abs(size[0] * frame.height / (size[1] * frame.width) - 1) > _ASPECT_TOLERANCE:
        raise InputError(f"{file}: normal map is {size[0]}x{size[1]}, its frame {frame.width}x{frame.height}")
    return lambda: resize_normals(unit_or_zero(_read(file)), frame.width, frame.height)


def _size(file: Path) -> tuple[int, int]:
    """Width and height of a map, from its header."""
    if file.suffix == ".png":
        return image_size(file)
    arrays = headers(file)
    shape, dtype = arrays[_key(file, list(arrays))]
    if dtype.kind != "f":
        raise InputError(f"{file}: normal map of type {dtype}, not of floats")
    if len(shape) != 3 or 0 in shape or 3 not in (shape[0], shape[2]):
        raise InputError(f"{file}: normal map has shape {list(shape)}, not [H, W, 3] or [3, H, W]")
    height, width = shape[:2] if shape[2] == 3 else shape[1:]
    return width, height


def _shows_photo(file: Path, size: tuple[int, int], frame: Frame, origin: Origin) -> bool:
    """Whether a map is of the distorted photo (else of the undistorted frame), by its size."""
    wholes = (origin.photo, origin.undistorted)
    exact = [size in [scaled_size(*whole, factor) for factor in _REDUCTIONS] for whole in wholes]
    exact[1] |= size == (frame.width, frame.height)
    of_photo, of_frame = exact if any(exact) else [same_shape(size, whole) for whole in wholes]
    if not (of_photo or of_frame) or (of_photo and of_frame and origin.photo != origin.undistorted):
        whose = "may be its photo's, {}x{}, or its" if of_photo else "neither its photo's, {}x{}, nor its"
        raise InputError(
            f"{file}: normal map is {size[0]}x{size[1]}, {whose.format(*origin.photo)} undistorted frame's, "
            f"{origin.undistorted[0]}x{origin.undistorted[1]}; `gsjax undistort` makes a data set where both are one"
        )
    return of_photo


def _read_undistorted(file: Path, frame: Frame, origin: Origin) -> np.ndarray:
    """A map of the frame's distorted photo, read where the frame's pixels are in it; the axes are the same."""
    # A larger map is averaged to the frame's scale first, or pixels between those that are read would not count.
    share = frame.width / origin.undistorted[0], frame.height / origin.undistorted[1]
    width, height = (max(1, round(side * s)) for side, s in zip(origin.photo, share, strict=True))
    unit = _shrunk(unit_or_zero(_read(file)), width, height)
    positions = origin.positions()
    source = positions * np.array([unit.shape[1], unit.shape[0]], np.float32) - np.float32(0.5)
    mixed = cv2.remap(unit, source, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    nearest = cv2.remap(unit, source, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    return _unit_where_known(mixed, np.where(positions[..., :1] < 0, np.float32(0), nearest))


def _shrunk(unit: np.ndarray, width: int, height: int) -> np.ndarray:
    """A map of unit vectors averaged down where it is larger than `width` x `height` in both directions."""
    if unit.shape[0] <= height or unit.shape[1] <= width:
        return unit
    mixed = cv2.resize(unit, (width, height), interpolation=cv2.INTER_AREA)
    return _unit_where_known(mixed, cv2.resize(unit, (width, height), interpolation=cv2.INTER_NEAREST))


def _unit_where_known(mixed: np.ndarray, nearest: np.ndarray) -> np.ndarray:
    """Means of vectors made unit; zero where the nearest one is, so that no edge is invented.

    Zero vectors add nothing to a mean's direction: what is unknown does not bleed into what is known.
    """
    return np.where(nearest.any(axis=-1, keepdims=True), unit_or_zero(mixed, 1e-3), np.float32(0))


def unit_or_zero(normals: np.ndarray, shortest: float = 0.0) -> np.ndarray:
    """Unit vectors, float32; one that is not longer than `shortest` becomes zero."""
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    usable = length > shortest
    return np.where(usable, normals / np.where(usable, length, 1), 0).astype(np.float32)


def _read(file: Path) -> np.ndarray:
    """`[H, W, 3]` float32 as the file has them."""
    if file.suffix == ".png":
        normals = _read_png(file)
    else:
        arrays = read_arrays(file)
        array = arrays[_key(file, list(arrays))]
        normals = array if array.shape[2] == 3 else array.transpose(1, 2, 0)
    broken = ~(np.abs(normals.astype(np.float64)) <= _LONGEST).all(axis=-1)
    if broken.any():
        raise InputError(f"{file}: {broken.sum()} pixels of the normal map are not finite")
    return normals.astype(np.float32)


def _key(file: Path, keys: list[str]) -> str:
    """The array of a file that is the map."""
    if "cam" not in keys and len(keys) != 1:
        raise InputError(f"{file}: needs an array cam, or only one; it holds {', '.join(keys)}")
    return "cam" if "cam" in keys else keys[0]


def _read_png(file: Path) -> np.ndarray:
    """`[H, W, 3]` float32 in -1..1, zero where the colour says nothing: middle grey, black or white."""
    pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.ndim != 3:
        raise InputError(f"{file}: not a whole image of three channels")
    pixels = pixels[..., 2::-1]
    top = np.iinfo(pixels.dtype).max
    normals = pixels.astype(np.float32) * np.float32(2 / top) - np.float32(1)
    size = np.abs(normals)
    nothing = (size < 1.5 / top).all(axis=-1) | (size == 1).all(axis=-1)
    return np.where(nothing[..., None], np.float32(0), normals)
