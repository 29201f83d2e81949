"""3D Gaussians as the PLY that viewers open (the layout of the original 3DGS code), and coloured points as PLY."""

import re
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians, PixelFilter
from gsjax.io.files import atomic_path

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_MEANS = ["x", "y", "z"]
_DC = [f"f_dc_{i}" for i in range(3)]
_SCALES = [f"scale_{i}" for i in range(3)]
_QUATS = [f"rot_{i}" for i in range(4)]  # w first
# As Brush and splat-transform tell it, and as Postshot does.
_FILTER_COMMENT = re.compile(r"^comment\s+(?:SplatRenderMode:\s*(\w+)|antialiased\s+(\d))\s*$", re.I | re.M)
_REST_COUNTS = [3 * ((degree + 1) ** 2 - 1) for degree in range(5)]


def write_gaussians(path: str | Path, gaussians: Gaussians) -> None:
    """Writes Gaussians as a binary little-endian 3DGS PLY: opacities as logits, scales as logs, quaternions w first.

    A pixel filter other than the classic one is told by a comment, as Brush and splat-transform have it.
    The coefficients `f_rest_*` run channel by channel. Normals are written as zeros, as viewers expect the columns.

    Raises:
        InputError: The target cannot be written.
    """
    count, bands, _ = gaussians.sh_rest.shape
    rest = np.asarray(gaussians.sh_rest).transpose(0, 2, 1).reshape(count, 3 * bands)
    rest_names = [f"f_rest_{i}" for i in range(3 * bands)]
    fields = [*_MEANS, "nx", "ny", "nz", *_DC, *rest_names, "opacity", *_SCALES, *_QUATS]
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
    header = ["ply", "format binary_little_endian 1.0"]
    header += ["comment SplatRenderMode: mip"] if gaussians.pixel_filter == "mip" else []
    header += [f"element vertex {len(table)}"] + [f"property float {name}" for name in fields] + ["end_header", ""]
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write("\n".join(header).encode())
        file.write(np.ascontiguousarray(table, "<f4").tobytes())


def read_gaussians(path: str | Path) -> Gaussians:
    """Reads a 3DGS PLY, ascii or binary, of any SH degree 0-4; columns in any order, foreign ones ignored.

    Returns:
        Gaussians of numpy float32 arrays.

    Raises:
        InputError: The file is no PLY or truncated, lacks columns (named), or holds values that are not finite.
    """
    path = Path(path)
    vertices, header = _read_vertices(path)
    names = vertices.dtype.names or ()
    rest_names = [f"f_rest_{i}" for i in range(sum(name.startswith("f_rest_") for name in names))]
    needed = [*_MEANS, *_DC, *rest_names, "opacity", *_SCALES, *_QUATS]
    missing = [name for name in needed if name not in names]
    if missing:
        raise InputError(f"{path}: not a PLY of Gaussians, it lacks {', '.join(missing)}")
    if len(rest_names) not in _REST_COUNTS:
        raise InputError(f"{path}: has {len(rest_names)} columns f_rest_*, degrees 0-4 have one of {_REST_COUNTS}")
    columns = {name: vertices[name].astype(np.float32) for name in needed}
    broken = ~np.isfinite(np.stack(list(columns.values()))).all(axis=0)
    if broken.any():
        raise InputError(f"{path}: {broken.sum()} of {len(vertices)} Gaussians hold values that are not finite")

    def stacked(chosen: list[str]) -> np.ndarray:
        return np.stack([columns[name] for name in chosen], axis=-1)

    rest = stacked(rest_names) if rest_names else np.zeros((len(vertices), 0), np.float32)
    return Gaussians(
        means=stacked(_MEANS),
        quats=stacked(_QUATS),
        log_scales=stacked(_SCALES),
        logit_opacities=columns["opacity"],
        sh_dc=stacked(_DC)[:, None],
        sh_rest=np.ascontiguousarray(rest.reshape(len(vertices), 3, len(rest_names) // 3).transpose(0, 2, 1)),
        pixel_filter=_pixel_filter(header),
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
    points = np.stack([vertices[name] for name in _MEANS], axis=-1).astype(np.float32)
    colors = np.full(points.shape, 128, np.uint8)
    if {"red", "green", "blue"} <= set(names):
        colors = np.stack([vertices[name] for name in ("red", "green", "blue")], axis=-1).astype(np.uint8)
    finite = np.isfinite(points).all(axis=1)
    if not finite.any():
        raise InputError(f"{path}: no points in it")
    return points[finite], colors[finite]


def _pixel_filter(header: str) -> PixelFilter:
    """What the comments say, the last of them where they disagree."""
    told = ["".join(either).lower() for either in _FILTER_COMMENT.findall(header)]
    return "mip" if told and told[-1] in ("mip", "1") else "classic"


def _read_vertices(path: Path) -> tuple[np.ndarray, str]:
    """The rows of the element `vertex`, which has to come first, as a structured array; and the header."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    end = data.find(b"end_header")
    body = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or body == 0:
        raise InputError(f"{path}: not a PLY file")
    header = data[:end].decode("ascii", "replace")
    form, count, dtype = _parse_header(path, header)
    if form == "ascii":
        return _ascii_rows(path, data[body:], count, dtype), header
    dtype = dtype.newbyteorder("<" if form == "binary_little_endian" else ">")
    if len(data) - body < count * dtype.itemsize:
        raise InputError(
            f"{path}: truncated, {count} vertices need {count * dtype.itemsize} bytes, {len(data) - body} left"
        )
    return np.frombuffer(data, dtype, count, body), header


def _parse_header(path: Path, header: str) -> tuple[str, int, np.dtype]:
    form, elements = "", []
    try:
        for words in (line.split() for line in header.splitlines()):
            if words[:1] == ["format"]:
                form = words[1]
            elif words[:1] == ["element"]:
                elements.append((words[1], int(words[2]), []))
            elif words[:1] == ["property"] and len(elements) == 1:
                elements[0][2].append((words[2], _TYPES[words[1]]))
        name, count, fields = elements[0]
        if name != "vertex" or count < 0 or form not in ("ascii", "binary_little_endian", "binary_big_endian"):
            raise ValueError(f"format {form!r}, first element {name!r}")
        return form, count, np.dtype(fields)
    except (IndexError, KeyError, ValueError) as error:
        raise InputError(f"{path}: PLY header not understood ({error})") from error


def _ascii_rows(path: Path, body: bytes, count: int, dtype: np.dtype) -> np.ndarray:
    lines = body.split(b"\n")[:count]
    try:
        return np.array([tuple(map(float, line.split())) for line in lines if line.strip()], dtype).reshape(count)
    except (ValueError, TypeError) as error:
        raise InputError(f"{path}: truncated or damaged, {count} ascii vertices were promised") from error
