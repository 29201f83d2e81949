"""PLY files as tables of numbers, and what PLY files of Gaussians share: words, and columns of other programs."""

import re
from collections.abc import Iterable, Sequence
from io import BytesIO
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.lib.recfunctions import unstructured_to_structured

from gsjax.errors import InputError
from gsjax.gaussians import PixelFilter
from gsjax.io.files import read_bytes
from gsjax.io.messages import print_once

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
# As Brush and splat-transform tell it, and as Postshot does.
_FILTER_COMMENT = re.compile(r"^comment\s+(?:SplatRenderMode:\s*(\w+)|antialiased\s+(\d))\s*$", re.I | re.M)
_NAMES = {kind: name for name, kind in reversed(_TYPES.items()) if not name.endswith(tuple("12468"))}
_REST_COUNTS = [3 * ((degree + 1) ** 2 - 1) for degree in range(5)]
GAUSSIAN_COLUMN = re.compile(r"[xyz]|n[xyz]|f_dc_[0-2]|f_rest_\d+|opacity|scale_[0-2]|rot_[0-3]|red|green|blue|alpha")
FILTER = re.compile("filter_?3d", re.IGNORECASE)  # of Mip-Splatting, GOF, RaDe-GS and MILo.
CHANGING = {  # What columns mean without which the others are no Gaussians as they are here.
    "Gaussians that move or fade over time": r"t|scal(e|ing)_t|rot_r_\d+|motion_\d+|omega_\d+|trbf_(center|scale)",
    "kernels other than Gaussians": r"beta|shape|nu(_degree)?",
    "colours other than spherical harmonics": r"s[gb]_\w+",
    "anchors of a network": r"f_offset_\d+|f_anchor_feat_\d+",
}


def read_elements(path: Path) -> tuple[dict[str, np.ndarray], str]:
    """The rows of every element as structured arrays, by name; and the header. Ascii or binary.

    Elements with lists (faces), and those after them, are left out, and so are those without columns.

    Raises:
        InputError: The file cannot be read, is no PLY, has no element without lists, or is truncated.
    """
    data = read_bytes(path)
    end = data.find(b"\nend_header") + 1
    start = data.find(b"\n", end) + 1
    if not data.startswith((b"ply", b"\xef\xbb\xbfply")) or 0 in (start, end):
        raise InputError(f"{path}: not a PLY file")
    header = data[:end].decode("ascii", "replace")
    form, elements = _parse_header(path, header)
    read = _ascii_rows if form == "ascii" else _binary_rows
    rows = {}
    for name, count, dtype in elements:
        rows[name], start = read(path, name, data, start, count, dtype)
    return rows, header


def encode_elements(elements: dict[str, np.ndarray], comments: Sequence[str] = ()) -> bytes:
    """A binary little-endian PLY of structured arrays by the elements' names; a column of records is one of lists.

    Such a record holds the length of its list, and the items.
    """
    lines = ["ply", "format binary_little_endian 1.0", *comments]
    for name, rows in elements.items():
        lines.append(f"element {name} {len(rows)}")
        for column in rows.dtype.names or ():
            parts = [kind for kind, *_ in (rows.dtype[column].fields or {"": (rows.dtype[column],)}).values()]
            kinds = ["list"] * (len(parts) > 1) + [_NAMES[kind.base.str[1:]] for kind in parts]
            lines.append(f"property {' '.join(kinds)} {column}")
    return b"".join(["\n".join([*lines, "end_header\n"]).encode(), *(rows.tobytes() for rows in elements.values())])


def table(names: Sequence[str], columns: np.ndarray, kind: str) -> np.ndarray:
    """The structured array of columns `[N, K]` of one type."""
    return unstructured_to_structured(columns.astype(kind), np.dtype([(name, kind) for name in names]))


def rest_columns(sh_rest: np.ndarray) -> np.ndarray:
    """`[N, 3K]` columns `f_rest_*` of `[N, K, 3]` coefficients: channel by channel."""
    count, bands, _ = sh_rest.shape
    return np.asarray(sh_rest).transpose(0, 2, 1).reshape(count, 3 * bands)


def rest_names(path: Path, names: tuple[str, ...]) -> list[str]:
    """The columns `f_rest_*` in their order."""
    count = sum(name.startswith("f_rest_") for name in names)
    if count not in _REST_COUNTS:
        raise InputError(f"{path}: has {count} columns f_rest_*, degrees 0-4 have one of {_REST_COUNTS}")
    expected = [f"f_rest_{i}" for i in range(count)]
    if not set(expected) <= set(names):
        raise InputError(f"{path}: its columns f_rest_* are not numbered from 0 to {count - 1}")
    return expected


def from_rest_columns(columns: np.ndarray) -> np.ndarray:
    """`[N, K, 3]` coefficients of `[N, 3K]` columns `f_rest_*`."""
    count, width = columns.shape
    return np.ascontiguousarray(columns.reshape(count, 3, width // 3).transpose(0, 2, 1))


def stack_columns(rows: np.ndarray, names: list[str], dtype: type = np.float32) -> np.ndarray:
    """`[N, K]` of K columns, in the order of `names`; what `dtype` cannot hold is infinite, and any NaN stays one."""
    with np.errstate(over="ignore", invalid="ignore"):
        columns = np.array([rows[name] for name in names], dtype)
    return np.ascontiguousarray(columns.reshape(len(names), len(rows)).T)


def filter_comments(pixel_filter: PixelFilter) -> list[str]:
    """The lines of the header that state a pixel filter; the classic one is what a file without them means."""
    return ["comment SplatRenderMode: mip"] if pixel_filter == "mip" else []


def read_filter(header: str) -> PixelFilter:
    """What the comments say, the last of them where they disagree."""
    values = ["".join(either).lower() for either in _FILTER_COMMENT.findall(header)]
    return "mip" if values and values[-1] in ("mip", "1") else "classic"


def _parse_header(path: Path, header: str) -> tuple[str, list[tuple[str, int, np.dtype]]]:
    """The form of the body; name, count and type of the elements with columns up to the first with a list."""
    form, elements = "", []
    try:
        for words in (line.split() for line in header.splitlines()):
            if words[:1] == ["format"]:
                form = words[1]
            elif words[:1] == ["element"]:
                elements.append((words[1], int(words[2]), []))
            elif words[:2] == ["property", "list"]:
                if elements[-1][0] == "vertex":
                    raise ValueError("its vertices have lists, which are not read")
                del elements[-1]
                break
            elif words[:1] == ["property"]:
                elements[-1][2].append((words[2], _TYPES[words[1]]))
        if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
            raise ValueError(f"format {form!r}")
        order = ">" if form == "binary_big_endian" else "<"
        # Gsplat's harmonics of degree 0 have no columns; ValueError of a column that is there twice.
        typed = [(name, count, np.dtype(fields).newbyteorder(order)) for name, count, fields in elements if fields]
        if not typed or any(count < 0 for _, count, _ in elements):
            raise ValueError("no element of plain numbers comes first")
    except (IndexError, KeyError, ValueError) as error:
        raise InputError(f"{path}: PLY header not understood ({error})") from error
    return form, typed


def _binary_rows(path: Path, name: str, data: bytes, start: int, count: int, dtype: np.dtype) -> tuple[np.ndarray, int]:
    needed, left = count * dtype.itemsize, max(0, len(data) - start)
    if left < needed:
        raise InputError(f"{path}: truncated, {count} rows of {name!r} need {needed} bytes, {left} left")
    return np.frombuffer(data, dtype, count, start), start + needed


def _ascii_rows(path: Path, name: str, data: bytes, start: int, count: int, dtype: np.dtype) -> tuple[np.ndarray, int]:
    body = BytesIO(data)
    body.seek(start)
    lines = islice((line for line in iter(body.readline, b"") if line.strip()), count)
    try:
        return np.array([tuple(map(float, line.split())) for line in lines], dtype).reshape(count), body.tell()
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{path}: truncated or damaged, {count} ascii rows of {name!r} were promised") from error


def filter_column(path: Path, names: Iterable[str]) -> str | None:
    """The column of 3D filters that a file has, if any; a line names columns that are not read.

    InputError names columns that change what the others mean.
    """
    foreign = [name for name in names if not GAUSSIAN_COLUMN.fullmatch(name)]
    for what, pattern in CHANGING.items():
        if changing := [name for name in foreign if re.fullmatch(pattern, name.lower())]:
            raise InputError(f"{path}: holds {what} ({', '.join(_grouped(changing))}), which are not read")
    filters = [name for name in foreign if FILTER.fullmatch(name)]
    report_unread(path, [name for name in foreign if name not in filters])
    return filters[0] if filters else None


def report_unread(path: Path, names: Sequence[str]) -> None:
    """Names columns that are not read, if any, in one line."""
    if names:
        print_once(f"{path}: columns that are not read: {', '.join(_grouped(names))}")


def _grouped(names: Sequence[str]) -> list[str]:
    """The names, where a series that differs by its last numbers is one: `label_*`."""
    stems = [re.sub(r"\d+$", "*", name) for name in names]
    return list(dict.fromkeys(s if stems.count(s) > 1 else n for s, n in zip(stems, names, strict=True)))


def fuse_filter(log_scales: np.ndarray, logits: np.ndarray, filters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log scales and logits, float32, smoothed by an isotropic 3D filter each (Mip-Splatting, arXiv:2311.16493, eq. 9).

    Variances grow by that of the filter, and opacities shrink by the root of the determinants' ratio.

    Args:
        log_scales: `[N, K]` logs of the deviations along the axes.
        logits: `[N, 1]` of the opacities.
        filters: `[N, 1]` deviations of the filters, scene units.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        before = log_scales.astype(np.float64)
        after = np.logaddexp(2 * before, 2 * np.log(np.abs(filters.astype(np.float64)))) / 2
        log_ratio = (before - after).sum(axis=1, keepdims=True)
        log_opacity, log_rest = -np.logaddexp(0, -logits.astype(np.float64)), -np.logaddexp(0, logits)
        # What remains transparent: 1 - ratio * opacity, without the loss of digits where both are near 1.
        transparent = np.exp(log_rest) - np.exp(log_opacity) * np.expm1(log_ratio)
        fused = log_opacity + log_ratio - np.log(transparent)
        return after.astype(np.float32), fused.astype(np.float32)
