"""A cloud of points from a file, such as a LiDAR scan, to start training from."""

from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.ply import point_colors, tell_of_rounding
from gsjax.io.ply_elements import read_elements, stack_columns


def read_points(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """`[P, 3]` float64 positions, in the file's own coordinates, and `[P, 3]` uint8 colours: grey where it has none.

    Raises:
        InputError: The file is no PLY with vertices, has fewer than two, or holds positions that are not finite.
    """
    path = Path(path)
    rows = read_elements(path)[0].get("vertex")
    names = set(() if rows is None else rows.dtype.names)
    if rows is None or not {"x", "y", "z"} <= names:
        raise InputError(f"{path}: has no points (an element vertex with x, y and z)")
    points = stack_columns(rows, ["x", "y", "z"], np.float64)
    if len(points) < 2:
        raise InputError(f"{path}: {len(points)} points in it, at least 2 are needed")
    broken = int((~np.isfinite(points).all(axis=-1)).sum())
    if broken:
        raise InputError(f"{path}: {broken} of its {len(points)} points are not finite")
    tell_of_rounding(path, rows, points)
    return points, point_colors(rows)
