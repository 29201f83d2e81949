"""Poses, lenses and the unit of measured depth as a frame of `transforms.json` states them.

Matrices are camera to world with OpenGL camera axes (x right, y up, looking along -z).
"""

import math
import reprlib
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.io.images import image_size
from gsjax.io.lenses import Lens, check_lens
from gsjax.scene import DepthFile
from gsjax.scene.similarity import is_float32

# For each `camera_model`, in capitals: COLMAP's model and the coefficients that it takes after fx, fy, cx, cy.
_RADIAL = ("PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
_MODELS = {
    **dict.fromkeys(("PINHOLE", "SIMPLE_PINHOLE"), ("PINHOLE", ())),
    **dict.fromkeys(_RADIAL, ("FULL_OPENCV", ("k1", "k2", "p1", "p2", "k3", "", "", ""))),
    "FULL_OPENCV": ("FULL_OPENCV", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "OPENCV_FISHEYE": ("OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
}
_COEFFICIENTS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_DEPTH_UNIT, _MILLIMETRE = "depth_unit_scale_factor", 0.001  # metres a unit; and the default of nerfstudio
_UNEVEN = 1e-2  # share by which rounding may make the axes of a camera differ in length


def viewmat_of(file: Path, entry: dict[str, Any]) -> np.ndarray:
    """World to camera, `[4, 4]` float64; a rotation that is off by rounding, or scaled evenly, is made exact."""
    where = f"{file}: transform_matrix of {entry['file_path']}"
    try:
        matrix = np.array(entry["transform_matrix"], np.float64)
    except (KeyError, ValueError, TypeError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape not in ((4, 4), (3, 4)) or not is_float32(matrix).all():
        raise InputError(f"{where} is not a finite 4x4 matrix")
    bottom = matrix[3] if len(matrix) == 4 else np.array([0.0, 0.0, 0.0, 1.0])
    if not (bottom[3] > 0 and np.abs(bottom[:3]).max() <= _UNEVEN * bottom[3]):
        raise InputError(f"{where} does not end in a row 0, 0, 0, 1")
    camera_to_world = np.eye(4)
    camera_to_world[:3] = matrix[:3] / bottom[3]
    left, stretch, right = np.linalg.svd(camera_to_world[:3, :3])
    is_even = stretch.max() - stretch.min() <= 2 * _UNEVEN * stretch.mean() > 0
    if not is_even or not is_float32(camera_to_world).all() or np.linalg.det(left @ right) < 0:
        factors = ", ".join(f"{value:.4g}" for value in stretch)
        raise InputError(f"{where} is not a rotation and a translation (it mirrors, or stretches by {factors})")
    camera_to_world[:3, :3] = left @ right
    return np.linalg.inv(camera_to_world @ _OPENGL_TO_OPENCV)


def lens_of(file: Path, entry: dict[str, Any], path: Path) -> Lens:
    """The lens of a frame, as large as the entry says, or else as its photo at `path` is."""
    where = f"{file}: camera of {entry['file_path']}"
    name = entry.get("camera_model") or ("OPENCV_FISHEYE" if entry.get("is_fisheye") else "OPENCV")
    model = name.upper() if isinstance(name, str) else ""
    width, height = _number(where, entry, "w"), _number(where, entry, "h")
    width, height = (int(width), int(height)) if width and height else image_size(path)
    if model == "EQUIRECTANGULAR":
        return check_lens(Lens(model, width, height, (float(width), float(height))), where)
    if model not in _MODELS:
        text = repr(name) if isinstance(name, str) else "that is no text"
        raise InputError(f"{file}: unknown camera_model {text}; known are {', '.join(_MODELS)}, EQUIRECTANGULAR")
    colmap, coefficients = _MODELS[model]
    values = {key: value for key in _COEFFICIENTS if (value := _number(where, entry, key))}
    foreign = sorted(set(values) - set(coefficients))
    if foreign:
        raise InputError(f"{file}: camera_model {model} takes no {', '.join(foreign)} ({entry['file_path']})")
    if not values and colmap == "FULL_OPENCV":
        colmap, coefficients = "PINHOLE", ()
    cx, cy = _number(where, entry, "cx"), _number(where, entry, "cy")
    center = (width / 2 if cx is None else cx, height / 2 if cy is None else cy)
    focals = _focal_lengths(where, entry, width, height)
    params = (*focals, *center, *(values.get(key, 0.0) for key in coefficients))
    return check_lens(Lens(colmap, width, height, params), where)


def depth_of(entry: dict[str, Any], path: Path | None) -> DepthFile | None:
    """The depth map of a frame, in millimetres or as `depth_unit_scale_factor` says (nerfstudio); NaN of no number."""
    if path is None:
        return None
    factor = entry.get(_DEPTH_UNIT)
    try:
        return DepthFile(path, _MILLIMETRE if factor is None else float(factor))
    except (TypeError, ValueError, OverflowError):
        return DepthFile(path, math.nan)


def _focal_lengths(where: str, entry: dict[str, Any], width: int, height: int) -> tuple[float, float]:
    """From `fl_x`, `fl_y`, or the angles of view; where one axis is missing, pixels are square."""
    focals: dict[str, float] = {}
    for axis, side in (("x", width), ("y", height)):
        stated, angle = _number(where, entry, f"fl_{axis}"), _number(where, entry, f"camera_angle_{axis}")
        if stated is not None:
            focals[axis] = stated
        elif angle is not None and not 0 < angle < math.pi:
            raise InputError(f"{where} has camera_angle_{axis} {angle:g}, which is no angle of view in radians")
        elif angle is not None:
            focals[axis] = 0.5 * side / max(math.tan(0.5 * angle), 1e-30)
    if not focals:
        raise InputError(f"{where} has neither fl_x nor camera_angle_x")
    either = next(iter(focals.values()))
    return focals.get("x", either), focals.get("y", either)


def _number(where: str, entry: dict[str, Any], key: str) -> float | None:
    """A finite number of an entry; None where it has none."""
    value = entry.get(key)
    if value is None:
        return None
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not is_float32(np.array(number)):
        text = reprlib.repr(value) if isinstance(value, str | int | float) else f"a {type(value).__name__}"
        raise InputError(f"{where} has {key} {text}, which is no number to compute with")
    return number
