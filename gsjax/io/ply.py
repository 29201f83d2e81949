"""PLY files: 3D Gaussians in the layout of the original 3DGS code, coloured points, and coloured triangles."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.lib.recfunctions import unstructured_to_structured
from scipy.spatial import KDTree

from gsjax.errors import InputError
from gsjax.gaussians import SH_C0, Gaussians, rgb_to_sh, smallest_axes
from gsjax.io.bad_items import leave_out_rows
from gsjax.io.files import atomic_path
from gsjax.io.georeference_files import place_comments
from gsjax.io.messages import print_once
from gsjax.io.ply_elements import (
    encode_elements,
    filter_column,
    filter_comments,
    from_rest_columns,
    fuse_filter,
    read_elements,
    read_filter,
    rest_columns,
    rest_names,
    stack_columns,
)
from gsjax.scene.colors import shares, to_bytes
from gsjax.scene.georeference import UNPLACED, Place
from gsjax.scene.meshes import Mesh
from gsjax.scene.similarity import as_needed, is_float32, loses_in_float32, spread

_MEANS = ["x", "y", "z"]
_DC = [f"f_dc_{i}" for i in range(3)]
_SCALES = [f"scale_{i}" for i in range(3)]
_QUATS = [f"rot_{i}" for i in range(4)]  # w first
_RGB = ["red", "green", "blue"]
_RGB_NAMES = [_RGB, *([f"{kind}_{name}" for name in _RGB] for kind in ("diffuse", "scalar")), ["r", "g", "b"]]
_GREY = 128
_ROUNDED = 1e-3  # of the spread of points, by which rounding may move them without a word
_OF_DISCS = 1e-4  # Of the thinner of a disc's other two deviations: where a file gives it no thickness.
_SURE = 88.0  # Logit of an opacity that is 0 or 1 in float32; its exponential is still a number.


def write_gaussians(
    path: str | Path, gaussians: Gaussians, place: Place = UNPLACED, *, cameras: np.ndarray | None = None
) -> int:
    """Writes Gaussians as a binary little-endian 3DGS PLY: opacities as logits, scales as logs, quaternions w first.

    Means are float, as all viewers expect, but double where float would lose their place (`loses_in_float32`).
    Comments state a pixel filter other than the classic one, as Brush and splat-transform have it, and the place.
    The coefficients `f_rest_*` run channel by channel. Normals are the smallest axes: unit vectors that face the
    nearest of the `cameras` (`[C, 3]` centres) or, without cameras, away from the median of the means.

    Returns:
        0: no Gaussian is clipped.
    """
    rest = rest_columns(gaussians.sh_rest)
    rest_fields = [f"f_rest_{i}" for i in range(rest.shape[1])]
    fields = [*_MEANS, "nx", "ny", "nz", *_DC, *rest_fields, "opacity", *_SCALES, *_QUATS]
    means = np.asarray(gaussians.means)
    columns = [
        _oriented_axes(gaussians, cameras),
        np.asarray(gaussians.sh_dc)[:, 0],
        rest,
        np.asarray(gaussians.logit_opacities)[:, None],
        gaussians.log_scales,
        gaussians.quats,
    ]
    kinds = dict.fromkeys(_MEANS, "<f8") if loses_in_float32(means) else {}
    rows = np.concatenate([means, *(np.asarray(each, np.float32) for each in columns)], axis=1)
    vertices = unstructured_to_structured(rows, np.dtype([(name, kinds.get(name, "<f4")) for name in fields]))
    comments = filter_comments(gaussians.pixel_filter) + place_comments(place)
    with atomic_path(path) as temporary:
        temporary.write_bytes(encode_elements({"vertex": vertices}, comments))
    return 0


def _oriented_axes(gaussians: Gaussians, cameras: np.ndarray | None) -> np.ndarray:
    """`[N, 3]` smallest axes, turned to the nearest camera or, without cameras, away from the median of the means."""
    axes = np.array(smallest_axes(gaussians))
    is_placed = np.isfinite(gaussians.means).all(1)  # Readers leave the other rows out: their axes need no direction.
    if not is_placed.any():
        return axes
    means = np.asarray(gaussians.means)[is_placed].astype(np.float64)
    if cameras is None or not len(cameras):
        directions = means - np.median(means, axis=0)
    else:
        directions = cameras[KDTree(cameras).query(means)[1]] - means
    is_reversed = np.sum(axes[is_placed] * directions, axis=1, keepdims=True) < 0
    axes[is_placed] *= np.where(is_reversed, -1, 1).astype(axes.dtype)
    return axes


def read_gaussians(path: str | Path) -> Gaussians:
    """Reads a 3DGS PLY, ascii or binary, of any SH degree 0-4; columns in any order, foreign ones named in a line.

    Opacities of exactly 0 and 1, whose logits are infinite, become logits of -88 and 88: the same opacities in float32.
    2DGS's discs, whose third scale is absent or of minus infinity, get one of a ten-thousandth of their others, and a
    line says so. 3D filters (`filter_3D` of Mip-Splatting, GOF, RaDe-GS and MILo) are fused into scales and opacities.
    Nerfstudio's `--ply-color-mode rgb` has red, green and blue instead of harmonics. Rows that are not finite are left
    out, and a line says how many.

    Returns:
        Gaussians of numpy float32 arrays; the means are float64 where float32 would lose their place.

    Raises:
        InputError: The file is no PLY or truncated, is a compressed one, lacks columns or has some that change what
            the others mean (named), or holds no Gaussian of finite values.
    """
    path = Path(path)
    vertices, header = _read_vertices(path)
    names = vertices.dtype.names or ()
    if "packed_position" in names:
        raise InputError(f"{path}: holds compressed Gaussians; name it {path.stem}.compressed.ply")
    filters = filter_column(path, names)
    rest = rest_names(path, names)
    in_rgb = not set(_DC) & set(names) and set(_RGB) <= set(names)
    scales = _SCALES if _SCALES[2] in names else _SCALES[:2]
    missing = [n for n in [*_MEANS, *(() if in_rgb else _DC), *rest, "opacity", *scales, *_QUATS] if n not in names]
    if missing:
        raise InputError(f"{path}: not a PLY of Gaussians, it lacks {', '.join(missing)}")
    log_scales, logits = stack_columns(vertices, scales), _finite_logits(stack_columns(vertices, ["opacity"]))
    if filters is not None:
        log_scales, logits = fuse_filter(log_scales, logits, stack_columns(vertices, [filters]))
        print_once(f"{path}: {filters} is fused into scales and opacities")
    columns = [
        as_needed(stack_columns(vertices, _MEANS, np.float64)),
        stack_columns(vertices, _QUATS),
        _with_thickness(path, log_scales),
        _finite_logits(logits),
        np.asarray(rgb_to_sh(_colors(vertices, _RGB))) if in_rgb else stack_columns(vertices, _DC),
        stack_columns(vertices, rest),
    ]
    fine = is_float32(np.concatenate(columns, axis=1)).all(axis=1)
    if not fine.all():
        message = f"{path}: {(~fine).sum()} of {len(fine)} Gaussians hold values that are not finite"
        if not fine.any():
            raise InputError(message)
        print_once(f"{message}; they are left out")
    means, quats, log_scales, logits, dc, rest = (column[fine] for column in columns)
    return Gaussians(
        means, quats, log_scales, logits[:, 0], dc[:, None], from_rest_columns(rest), pixel_filter=read_filter(header)
    )


def _finite_logits(logits: np.ndarray) -> np.ndarray:
    """Opacities of 0 and 1, which files write as infinities, as numbers; what is no number stays so, to be counted."""
    return np.where(np.isinf(logits), np.copysign(np.float32(_SURE), logits), logits)


def read_points(path: str | Path, least: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Points `[P, 3]` float64 and colours `[P, 3]` uint8 of a PLY; grey where it has no colours.

    Points that are not finite are left out (`gsjax.io.bad_items`). InputError where fewer than `least` are in it.
    """
    path = Path(path)
    vertices, _ = _read_vertices(path)
    names = vertices.dtype.names or ()
    if not set(_MEANS) <= set(names):
        raise InputError(f"{path}: not a PLY of points, it lacks {', '.join(n for n in _MEANS if n not in names)}")
    points = stack_columns(vertices, _MEANS, np.float64)
    if len(points) < least:
        raise InputError(f"{path}: {len(points)} points in it, at least {least} are needed")
    finite = is_float32(points).all(axis=1)
    leave_out_rows(path, "points", finite)
    _report_rounding(path, vertices, points[finite])
    return points[finite], _point_colors(vertices)[finite]


def _report_rounding(path: Path, vertices: np.ndarray, points: np.ndarray) -> None:
    """One line where the single precision of rows has moved their `[P, 3]` points by a thousandth of their spread."""
    step = float(np.spacing(np.abs(np.median(points, axis=0)).max().astype(np.float32)))
    if vertices.dtype["x"].str[1:] == "f4" and 0 < _ROUNDED * spread(points) < step / 2:
        print_once(
            f"{path}: its points are in single precision, which there is a grid of {step:g}; save them as doubles, or"
            " about a nearer origin"
        )


def _point_colors(vertices: np.ndarray) -> np.ndarray:
    """`[P, 3]` uint8 colours of points, or of the centres of Gaussians; grey where they have none."""
    names = vertices.dtype.names or ()
    rgb = _color_names(names)
    if rgb is not None:
        return to_bytes(_colors(vertices, rgb))
    if set(_DC) <= set(names):
        values = stack_columns(vertices, _DC)
        return to_bytes(SH_C0 * np.where(np.isnan(values), 0, values) + 0.5)
    return np.full((len(vertices), 3), _GREY, np.uint8)


def read_vertex_colors(path: Path) -> np.ndarray | None:
    """`[V, 3]` uint8 colours of a PLY's vertices, of numbers of any type; None where it has none that are read here."""
    try:
        vertices, _ = _read_vertices(path)
    except InputError:  # Of vertices with lists.
        return None
    rgb = _color_names(vertices.dtype.names or ())
    return None if rgb is None else to_bytes(_colors(vertices, rgb))


def _with_thickness(path: Path, log_scales: np.ndarray) -> np.ndarray:
    """`[N, 3]` log scales of `[N, 2 or 3]`: minus infinity, or a third that is absent, is the thickness of a disc."""
    if log_scales.shape[1] == 2:
        log_scales = np.pad(log_scales, ((0, 0), (0, 1)), constant_values=-np.inf)
    flat = np.isneginf(log_scales)
    if flat.any():
        print_once(f"{path}: {flat.any(axis=1).sum()} of {len(flat)} are discs, {_OF_DISCS:g} of their radius thick")
    with np.errstate(invalid="ignore"):  # What is no number is looked for later, in all columns.
        thinnest = np.min(log_scales, axis=1, keepdims=True, where=~flat, initial=np.inf)
        return np.where(flat, thinnest + np.float32(np.log(_OF_DISCS)), log_scales)


def _color_names(names: Sequence[str]) -> list[str] | None:
    """The columns of red, green and blue, as programs call them, in any case; None where there are none."""
    own = {name.lower(): name for name in reversed(names)}
    return next(([own[name] for name in rgb] for rgb in _RGB_NAMES if set(rgb) <= own.keys()), None)


def _colors(vertices: np.ndarray, rgb: list[str]) -> np.ndarray:
    """`[N, 3]` float32 in 0..1: floats up to 1 are shares, other numbers those of a byte, or of two beyond 255."""
    colors, kind = stack_columns(vertices, rgb), vertices.dtype[rgb[0]]
    if kind.itemsize == 1:
        return colors / np.float32(np.iinfo(kind).max)
    return colors / np.float32(255) if kind.kind in "iu" and colors.max(initial=0) <= 1 else shares(colors)


def _read_vertices(path: Path) -> tuple[np.ndarray, str]:
    elements, header = read_elements(path)
    if "vertex" not in elements:
        raise InputError(f"{path}: has no element 'vertex', only {', '.join(elements)}")
    return elements["vertex"], header


def encode_mesh(mesh: Mesh, place: Place = UNPLACED) -> bytes:
    """Coloured triangles as a binary PLY, positions double where float would lose them; a comment states the place."""
    position = "<f8" if loses_in_float32(mesh.vertices) else "<f4"
    kinds = [*((name, position) for name in _MEANS), *((name, "u1") for name in _RGB)]
    columns = np.concatenate([mesh.vertices, mesh.colors.astype(mesh.vertices.dtype)], axis=1)
    faces = np.empty(mesh.num_faces, [("vertex_indices", [("count", "u1"), ("corners", "<i4", 3)])])
    faces["vertex_indices"]["count"], faces["vertex_indices"]["corners"] = 3, mesh.faces
    return encode_elements(
        {"vertex": unstructured_to_structured(columns, np.dtype(kinds)), "face": faces}, place_comments(place)
    )
