"""3D Gaussians as the PLY that viewers open (the layout of the original 3DGS code), and coloured points as PLY."""

from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.io.files import atomic_path
from gsjax.io.ply_elements import (
    filter_comments,
    from_rest_columns,
    read_elements,
    rest_columns,
    rest_names,
    stacked,
    told_filter,
)

_MEANS = ["x", "y", "z"]
_DC = [f"f_dc_{i}" for i in range(3)]
_SCALES = [f"scale_{i}" for i in range(3)]
_QUATS = [f"rot_{i}" for i in range(4)]  # w first
_SURE = 88.0  # Logit of an opacity that is 0 or 1 in float32; its exponential is still a number.


def write_gaussians(path: str | Path, gaussians: Gaussians) -> None:
    """Writes Gaussians as a binary little-endian 3DGS PLY: opacities as logits, scales as logs, quaternions w first.

    A pixel filter other than the classic one is told by a comment, as Brush and splat-transform have it.
    The coefficients `f_rest_*` run channel by channel. Normals are written as zeros, as viewers expect the columns.

    Raises:
        InputError: The target cannot be written.
    """
    rest = rest_columns(gaussians.sh_rest)
    count, width = rest.shape
    fields = [*_MEANS, "nx", "ny", "nz", *_DC, *[f"f_rest_{i}" for i in range(width)], "opacity", *_SCALES, *_QUATS]
    columns = [
        gaussians.means,
        np.zeros((count, 3)),
        np.asarray(gaussians.sh_dc)[:, 0],
        rest,
        np.asarray(gaussians.logit_opacities)[:, None],
        gaussians.log_scales,
        gaussians.quats,
    ]
    table = np.concatenate([np.asarray(c, "<f4") for c in columns], axis=1)
    header = ["ply", "format binary_little_endian 1.0", *filter_comments(gaussians.pixel_filter)]
    header += [f"element vertex {len(table)}"] + [f"property float {name}" for name in fields] + ["end_header", ""]
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write("\n".join(header).encode())
        file.write(np.ascontiguousarray(table, "<f4").tobytes())


def read_gaussians(path: str | Path) -> Gaussians:
    """Reads a 3DGS PLY, ascii or binary, of any SH degree 0-4; columns in any order, foreign ones ignored.

    Opacities of exactly 0 and 1, whose logits are infinite, become logits of -88 and 88: the same opacities in float32.

    Returns:
        Gaussians of numpy float32 arrays.

    Raises:
        InputError: The file is no PLY or truncated, is a compressed one, lacks columns (named), or holds values that
            are not finite.
    """
    path = Path(path)
    vertices, header = _read_vertices(path)
    names = vertices.dtype.names or ()
    if "packed_position" in names:
        raise InputError(f"{path}: holds compressed Gaussians; name it {path.stem}.compressed.ply")
    rest = rest_names(path, names)
    missing = [name for name in [*_MEANS, *_DC, *rest, "opacity", *_SCALES, *_QUATS] if name not in names]
    if missing:
        raise InputError(f"{path}: not a PLY of Gaussians, it lacks {', '.join(missing)}")
    columns = [stacked(vertices, part) for part in (_MEANS, _QUATS, _SCALES, ["opacity"], _DC, rest)]
    columns[3] = np.where(np.isinf(columns[3]), np.copysign(_SURE, columns[3]), columns[3]).astype(np.float32)
    broken = ~np.isfinite(np.concatenate(columns, axis=1)).all(axis=1)
    if broken.any():
        raise InputError(f"{path}: {broken.sum()} of {len(vertices)} Gaussians hold values that are not finite")
    means, quats, log_scales, logits, dc, rest = columns
    return Gaussians(
        means, quats, log_scales, logits[:, 0], dc[:, None], from_rest_columns(rest), pixel_filter=told_filter(header)
    )


def read_points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Points `[P, 3]` float32 and colours `[P, 3]` uint8 of a PLY; grey where it has no colours.

    Raises:
        InputError: The file is missing, no PLY, truncated, without x, y, z, or holds no finite point.
    """
    vertices, _ = _read_vertices(path)
    names = vertices.dtype.names or ()
    if not set(_MEANS) <= set(names):
        raise InputError(f"{path}: not a PLY of points, it lacks {', '.join(n for n in _MEANS if n not in names)}")
    points = stacked(vertices, _MEANS)
    colors = np.full(points.shape, 128, np.uint8)
    if {"red", "green", "blue"} <= set(names):
        colors = stacked(vertices, ["red", "green", "blue"]).astype(np.uint8)
    finite = np.isfinite(points).all(axis=1)
    if not finite.any():
        raise InputError(f"{path}: no points in it")
    return points[finite], colors[finite]


def _read_vertices(path: Path) -> tuple[np.ndarray, str]:
    elements, header = read_elements(path)
    if "vertex" not in elements:
        raise InputError(f"{path}: has no element 'vertex', only {', '.join(elements)}")
    return elements["vertex"], header
