"""Which part of a depth map its photo shows, and the map's values at the pixels of the photo's frame.

Sensors of depth have another shape than cameras: 640x480 for 1296x968 (ScanNet), 848x480 for 1280x720
(RealSense), 256x192 for 3840x2160 (video of an iPad).
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsjax.errors import InputError
from gsjax.io.images import same_shape
from gsjax.scene import Frame

_LEAST = 0.5  # of a map's pixels: where the photo's shape leaves less, the map is of another view


class Window(NamedTuple):
    """The rectangle of a map that shows what a photo shows; it may reach beyond the map."""

    left: float  # pixels of the map
    top: float
    right: float
    bottom: float
    is_undistorted: bool = False  # it shows what the frame shows; else what the photo does, distorted as that is


def window_of(file: Path, size: tuple[int, int], frame: Frame, intrinsics: np.ndarray | None) -> tuple[Window, str]:
    """The window of a frame's map, and how it was found where that is not the whole map, or "".

    With intrinsics `[3, 3]`, pixels of the map, it is that of a camera in the photo's place, without distortion. Else
    the map shows as much as its photo, or more at two opposite sides: its middle of the photo's shape is the window.
    InputError where the shapes are of different views.
    """
    width, height = size
    photo_size = (frame.width, frame.height) if frame.origin is None else frame.origin.photo
    if intrinsics is not None:
        scale = intrinsics[[0, 1], [0, 1]] / frame.K[[0, 1], [0, 1]]
        left, top = (float(value) for value in intrinsics[:2, 2] - scale * frame.K[:2, 2])
        right, bottom = left + float(scale[0]) * frame.width, top + float(scale[1]) * frame.height
        return Window(left, top, right, bottom, True), f"maps of {width}x{height} are read with their own intrinsics"
    if same_shape(size, photo_size):
        return Window(0, 0, width, height), ""
    shape = photo_size[0] / photo_size[1]
    across, down = min(width, height * shape), min(height, width / shape)
    is_turned = (width > height and shape < 1) or (width < height and shape > 1)
    if is_turned or across * down < _LEAST * width * height:
        turned = "; one of them is turned" if is_turned else ""
        raise InputError(f"{file}: depth map is {width}x{height}, its photo {photo_size[0]}x{photo_size[1]}{turned}")
    left, top = (width - across) / 2, (height - down) / 2
    note = (
        f"of maps of {width}x{height} the middle {across:.0f}x{down:.0f} is taken, the shape of photos of"
        f" {photo_size[0]}x{photo_size[1]}"
    )
    return Window(left, top, left + across, top + down), note


def on_grid(
    readings: tuple[np.ndarray, np.ndarray], frame: Frame, scale: int, window: Window
) -> tuple[np.ndarray, np.ndarray]:
    """What was measured, at the pixels of a frame: `[H // scale, W // scale]`, 0 where nothing was.

    Nothing is interpolated, because between two surfaces there is none: of a map that is larger than the frame, or of a
    distorted photo, each pixel takes the nearest value. Each value of a smaller map goes to the pixel that holds it.

    Args:
        readings: Depth and confidence, `[h, w]` of any size.
        frame: The photo's.
        scale: The frame is reduced by this factor; a rest at the right and the bottom is dropped.
        window: What of the map the photo shows.
    """
    if frame.origin is not None and not window.is_undistorted:
        readings = _undistorted(readings, frame.origin.positions(), window)
        window = Window(0, 0, frame.width, frame.height)
    sides = (frame.height, window.top, window.bottom), (frame.width, window.left, window.right)
    (to_rows, rows), (to_columns, columns) = (
        _matches(side, length, (low, high), scale)
        for (side, low, high), length in zip(sides, readings[0].shape, strict=True)
    )
    placed = []
    for values in readings:
        grid = np.zeros((frame.height // scale, frame.width // scale), values.dtype)
        grid[to_rows[:, None], to_columns] = values[rows[:, None], columns]
        placed.append(grid)
    return placed[0], placed[1]


def _undistorted(
    readings: tuple[np.ndarray, np.ndarray], positions: np.ndarray, window: Window
) -> tuple[np.ndarray, np.ndarray]:
    """At a frame's pixels, which are at these shares `[H, W, 2]` of the photo's sides; -1 beyond the photo."""
    height, width = readings[0].shape
    x, y = np.moveaxis(positions, -1, 0)
    column, row = (
        (low + np.clip(at, 0, 1) * (high - low)).astype(int)
        for at, low, high in ((x, window.left, window.right), (y, window.top, window.bottom))
    )
    nearest = np.minimum(row, height - 1), np.minimum(column, width - 1)
    depth, trust = (np.where(x < 0, 0, values[nearest]).astype(values.dtype) for values in readings)
    return depth, trust


def _matches(side: int, length: int, window: tuple[float, float], scale: int) -> tuple[np.ndarray, np.ndarray]:
    """Along one axis: places in a frame of `side` pixels that is reduced, and those of the map that belong there.

    The frame shows the `window` of a map that has `length` pixels.
    """
    low, high = window
    count, share = side // scale, (high - low) * scale / side  # of the map's pixels to one of the frame's
    if share >= 1:
        places = np.arange(count)
        own = np.floor(low + (places + 0.5) * share).astype(int)
    else:
        own = np.arange(length)
        places = np.floor((own + 0.5 - low) / share).astype(int)
    is_shown = (own >= 0) & (own < length) & (places >= 0) & (places < count)
    return places[is_shown], own[is_shown]
