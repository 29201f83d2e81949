"""Normal maps from a folder: the monocular prior, as any network may have written it."""

from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np

from gsjax.errors import InputError
from gsjax.io.images import cv2
from gsjax.io.photos import listed
from gsjax.io.truth import read_arrays
from gsjax.scene import Frame

_SUFFIXES = (".npy", ".npz", ".png")
_ASPECT_TOLERANCE = 0.02


def normal_maps(directory: str | Path, frames: tuple[Frame, ...]) -> dict[str, Callable[[], np.ndarray]]:
    """Readers of the frames' normal maps, each resized to its frame: one map at a time is in memory.

    A map has its frame's name with the suffix `.npy`, `.npz` (the array `cam`, or the only one) or `.png` (8 or 16
    bit, n = 2v - 1), in the same subfolder or in `directory` itself. Arrays are [H, W, 3] or [3, H, W]. Axes are the
    camera's: x right, y down, z forward.

    Args:
        directory: Folder of the maps.
        frames: The frames that need one each.

    Returns:
        Frame name -> function that reads [H, W, 3] float32, unit length, exactly zero where the map says nothing.

    Raises:
        InputError: A map is missing. Reading one raises it where the map is damaged, of another shape or aspect ratio,
            or holds values that are not finite.
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise InputError(f"{directory}: no such folder of normal maps")
    files = _files(directory, frames)
    missing = [name for name, file in files.items() if file is None]
    if missing:
        raise InputError(f"{directory}: {listed('normal map', missing)}")
    return {frame.name: partial(_read_map, files[frame.name], frame) for frame in frames}


def _files(directory: Path, frames: tuple[Frame, ...]) -> dict[str, Path | None]:
    """Each frame's map: under its whole name, or under its bare stem where no other frame shares that."""
    paths = {frame.name: PurePosixPath(frame.name) for frame in frames}
    shared = Counter(path.stem for path in paths.values())
    files = {}
    for name, path in paths.items():
        places = [path.with_suffix("")] + [PurePosixPath(path.stem)] * (shared[path.stem] == 1)
        candidates = [directory / f"{place}{suffix}" for place in places for suffix in _SUFFIXES]
        files[name] = next((c for c in candidates if c.is_file()), None)
    return files


def _read_map(file: Path, frame: Frame) -> np.ndarray:
    normals = _read_png(file) if file.suffix == ".png" else _read_array(file)
    if normals.ndim == 3 and normals.shape[0] == 3 and normals.shape[2] != 3:
        normals = normals.transpose(1, 2, 0)
    if normals.ndim != 3 or normals.shape[2] != 3 or 0 in normals.shape:
        raise InputError(f"{file}: normal map has shape {list(normals.shape)}, not [H, W, 3] or [3, H, W]")
    height, width = normals.shape[:2]
    if abs(width * frame.height / (height * frame.width) - 1) > _ASPECT_TOLERANCE:
        raise InputError(f"{file}: normal map is {width}x{height}, its frame {frame.width}x{frame.height}")
    broken = ~np.isfinite(normals).all(axis=-1)
    if broken.any():
        raise InputError(f"{file}: {broken.sum()} pixels of the normal map are not finite")
    return _resized(normals.astype(np.float32), frame.width, frame.height)


def _read_array(file: Path) -> np.ndarray:
    if file.suffix == ".npz":
        arrays = read_arrays(file)
        if "cam" not in arrays and len(arrays) != 1:
            raise InputError(f"{file}: needs an array cam, or only one; it holds {', '.join(arrays)}")
        array = arrays["cam"] if "cam" in arrays else next(iter(arrays.values()))
    else:
        try:
            array = np.load(file)
        except (OSError, ValueError, EOFError) as error:
            raise InputError(f"{file}: cannot be read ({error})") from error
    if array.dtype.kind != "f":
        raise InputError(f"{file}: normal map of type {array.dtype}, not of floats")
    return array


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


def _resized(normals: np.ndarray, width: int, height: int) -> np.ndarray:
    """Bilinear and unit again; zero where the nearest pixel of the map is zero, so that no edge is invented."""
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    unit = normals / np.where(length > 0, length, np.float32(1))
    known = (length[..., 0] > 0).astype(np.float32)
    if unit.shape[:2] != (height, width):
        unit = cv2.resize(unit, (width, height), interpolation=cv2.INTER_LINEAR)
        known = cv2.resize(known, (width, height), interpolation=cv2.INTER_NEAREST)
    length = np.linalg.norm(unit, axis=-1, keepdims=True)
    usable = (length > 1e-3) & (known[..., None] > 0)
    return np.where(usable, unit / np.where(usable, length, 1), 0).astype(np.float32)
