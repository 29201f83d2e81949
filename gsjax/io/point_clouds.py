"""A cloud of points from a file, such as a LiDAR scan, to start training from."""

from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.bad_items import leave_out_rows
from gsjax.io.ply import point_colors, tell_of_rounding
from gsjax.io.ply_elements import read_elements, stack_columns
from gsjax.scene.similarity import is_float32


def read_points(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """`[P, 3]` float64 positions, in the file's own coordinates, and `[P, 3]` uint8 colours: grey where it has none.

    Points that are not finite are left out (`gsjax.io.bad_items`).

    Raises:
        InputError: The file is no PLY with vertices, or has too few finite ones.
    """
    path = Path(path)
    rows = read_elements(path)[0].get("vertex")
    names = set(() if rows is None else rows.dtype.names)
    if rows is None or not {"x", "y", "z"} <= names:
        raise InputError(f"{path}: has no points (an element vertex with x, y and z)")
    points = stack_columns(rows, ["x", "y", "z"], np.float64)
    if len(points) < 2:
        raise InputError(f"{path}: {len(points)} points in it, at least 2 are needed")
    finite = is_float32(points).all(axis=-1)
    leave_out_rows(path, "points", finite)
    tell_of_rounding(path, rows, points[finite])
    return points[finite], point_colors(rows)[finite]
