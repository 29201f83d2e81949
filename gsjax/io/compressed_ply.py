"""The compressed PLY of PlayCanvas: 16 bytes a Gaussian, within the bounds of chunks of 256, and a byte a harmonic.

The layout is that of splat-transform (https://github.com/playcanvas/splat-transform, version 3.2.0): positions and logs
of scales in 11, 10 and 11 bits between their chunk's bounds; rotations as the index of the largest of (w, x, y, z) in 2
bits and the others in 10 each; colours in 8 bits between their chunk's bounds, opacities in 8 bits between 0 and 1;
harmonics in 8 bits between -4 and 4. A pixel filter is stated as in a plain PLY.
"""

from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.gaussians import SH_C0, Gaussians
from gsjax.io import packing, ply_elements
from gsjax.io.files import atomic_path
from gsjax.io.georeference_files import place_comments
from gsjax.scene.georeference import UNPLACED, Place

_CHUNK = 256
_MEANS, _SCALES, _COLORS = ("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b")
_PACKED = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
_IN_SPACE, _OF_ROTATIONS, _OF_COLORS = (11, 10, 11), (10, 10, 10), (8, 8, 8)  # bits
_MOST_LOG_SCALE = 20.0  # One Gaussian without thickness must not take the precision of its chunk.
_MOST_REST = 4.0
_MOST_COLOR = 4.0  # from black, which is 0; white is 1
_REACH = 16.0  # Of a chunk, see `pull_in_outliers`: a scene's own chunks stay as they are.
_REACH_OF_ORDER = 256.0  # Of all, where the curve's cells are as fine as the scene.


def write_compressed_ply(path: str | Path, gaussians: Gaussians, place: Place = UNPLACED) -> int:
    """Writes Gaussians in the order of a space-filling curve, so that chunks, and the steps in them, are small.

    Returns:
        How many Gaussians hold values that the format cannot reach: logs of scales beyond 20, harmonics and colours
        beyond 4, or a mean so far from its chunk that no other of that had its precision.

    Raises:
        InputError: Values are not finite, harmonics are of degree 4, or the target cannot be written.
    """
    packing.check_packable(path, gaussians)
    comments = ply_elements.filter_comments(gaussians.pixel_filter) + place_comments(place)
    order = packing.morton_order(packing.pull_in_outliers(np.asarray(gaussians.means, np.float64), _REACH_OF_ORDER)[0])
    means, quats, log_scales, logits, dc, rest = (
        np.asarray(values)[order]
        for values in (
            gaussians.means,
            gaussians.quats,
            gaussians.log_scales,
            gaussians.logit_opacities,
            gaussians.sh_dc,
            ply_elements.rest_columns(gaussians.sh_rest),
        )
    )
    largest, three = packing.smallest_three(packing.unit_quats(quats))
    means, far = _drawn_into_chunks(means.astype(np.float64))
    colors = dc[:, 0].astype(np.float64) * SH_C0 + 0.5
    bounds, packed = zip(
        _pack_between(means, _IN_SPACE),
        _pack_between(np.clip(log_scales, -_MOST_LOG_SCALE, _MOST_LOG_SCALE), _IN_SPACE),
        _pack_between(np.clip(colors, -_MOST_COLOR, _MOST_COLOR), _OF_COLORS),
        strict=True,
    )
    rotations = largest.astype(np.uint32) << 30 | _pack(three * np.sqrt(0.5) + 0.5, _OF_ROTATIONS)
    colors_opacities = packed[2] << 8 | packing.opacity_bytes(logits)
    harmonics = np.clip(np.floor((rest.astype(np.float64) / (2 * _MOST_REST) + 0.5) * 256), 0, 255).astype(np.uint8)
    columns = np.stack([packed[0], rotations, packed[1], colors_opacities], axis=1)
    elements = {
        "chunk": ply_elements.table(_names(_MEANS, _SCALES, _COLORS), np.concatenate(bounds, axis=1), "<f4"),
        "vertex": ply_elements.table(_PACKED, columns, "<u4"),
    }
    if harmonics.shape[1]:
        elements["sh"] = ply_elements.table([f"f_rest_{i}" for i in range(harmonics.shape[1])], harmonics, "u1")
    with atomic_path(path) as temporary:
        temporary.write_bytes(ply_elements.encode_elements(elements, comments))
    limited = (log_scales, _MOST_LOG_SCALE), (rest, _MOST_REST), (colors, _MOST_COLOR)
    beyond = [(np.abs(values) > most).any(axis=1) for values, most in limited]
    return int(np.any([far, *beyond], axis=0).sum())


def read_compressed_ply(path: str | Path) -> Gaussians:
    """Reads a compressed PLY as numpy float32 arrays; without bounds of colours these are between 0 and 1.

    Opacities of 0 and 255 get finite logits, a quarter of a step within 0 and 1.
    """
    path = Path(path)
    elements, header = ply_elements.read_elements(path)
    chunks, vertices = (elements.get(name, np.empty(0, [])) for name in ("chunk", "vertex"))
    chunk_columns, columns = chunks.dtype.names or (), vertices.dtype.names or ()

    is_packed = all(name in columns and vertices.dtype[name].str[1:] == "u4" for name in _PACKED)
    if not (is_packed and set(_names(_MEANS, _SCALES)) <= set(chunk_columns)):
        raise InputError(f"{path}: not a compressed PLY of Gaussians")
    ply_elements.report_unread(path, [name for name in columns if name not in _PACKED])
    if not np.isfinite(ply_elements.stack_columns(chunks, list(chunk_columns))).all():
        raise InputError(f"{path}: bounds of a chunk are not finite")
    count = len(vertices)
    harmonics = elements.get("sh", np.empty(count, []))  # None where the degree is 0.
    if len(chunks) != -(-count // _CHUNK) or len(harmonics) != count:
        raise InputError(
            f"{path}: {count} Gaussians do not go with {len(chunks)} chunks and {len(harmonics)} harmonics"
        )

    def unpacked(codes: np.ndarray, names: tuple[str, ...], bits: tuple[int, ...]) -> np.ndarray:
        low, high = np.split(ply_elements.stack_columns(chunks, _names(names)).astype(np.float64), 2, axis=1)
        units, chunk = _unpack(codes, bits), np.arange(count) // _CHUNK
        return low[chunk] * (1 - units) + high[chunk] * units

    largest, three = vertices["packed_rotation"] >> 30, _unpack(vertices["packed_rotation"], _OF_ROTATIONS)
    colors = vertices["packed_color"] >> 8
    is_bounded = set(_names(_COLORS)) <= set(chunk_columns)
    colors = unpacked(colors, _COLORS, _OF_COLORS) if is_bounded else _unpack(colors, _OF_COLORS)
    rest = ply_elements.stack_columns(harmonics, ply_elements.rest_names(path, harmonics.dtype.names or ()))
    rest = (np.where((rest > 0) & (rest < 255), (rest + 0.5) / 256, rest / 255) - 0.5) * 2 * _MOST_REST
    return packing.packed_gaussians(
        path,
        means=unpacked(vertices["packed_position"], _MEANS, _IN_SPACE),
        quats=packing.of_smallest_three(largest, (three - 0.5) / np.sqrt(0.5)),
        log_scales=unpacked(vertices["packed_scale"], _SCALES, _IN_SPACE),
        logit_opacities=packing.logits_of_bytes(vertices["packed_color"] & 255),
        sh_dc=((colors - 0.5) / SH_C0)[:, None],
        sh_rest=ply_elements.from_rest_columns(rest),
        pixel_filter=ply_elements.read_filter(header),
    )


def _names(*groups: tuple[str, ...]) -> list[str]:
    """The columns of the bounds of values, least and then most, group by group."""
    return [f"{end}_{name}" for names in groups for end in ("min", "max") for name in names]


def _drawn_into_chunks(means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`pull_in_outliers` of one chunk after the other."""
    starts = range(_CHUNK, len(means), _CHUNK)
    inner, far = zip(*(packing.pull_in_outliers(chunk, _REACH) for chunk in np.split(means, starts)), strict=True)
    return np.concatenate(inner), np.concatenate(far)


def _pack_between(values: np.ndarray, bits: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Bounds `[C, 6]` (least, then most) of the chunks of `[N, 3]` values, and the values packed between them `[N]`."""
    chunks = -(-len(values) // _CHUNK)
    index = np.minimum(np.arange(chunks * _CHUNK), len(values) - 1)  # The last chunk is filled up with the last.
    filled = values[index].reshape(chunks, _CHUNK, 3)
    # Float32 as the file has them, so that the steps are those that are read.
    low, high = (end.astype(np.float32).astype(np.float64) for end in (filled.min(axis=1), filled.max(axis=1)))
    span = high - low
    units = (filled - low[:, None]) / np.where(span > 0, span, 1)[:, None]
    return np.concatenate([low, high], axis=1), _pack(units.reshape(-1, 3)[: len(values)], bits)


def _pack(units: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """`[N]` uint32 of `[N, K]` numbers in 0..1, the first in the highest bits."""
    packed = np.zeros(len(units), np.uint32)
    for column, width in zip(units.T, bits, strict=True):
        packed = packed << width | np.rint(np.clip(column, 0, 1) * (2**width - 1)).astype(np.uint32)
    return packed


def _unpack(packed: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """`[N, K]` float64 of what `_pack` gives; higher bits than `bits` are ignored."""
    shifts = [sum(bits[place + 1 :]) for place in range(len(bits))]
    return np.stack([(packed >> s & 2**b - 1) / (2**b - 1) for s, b in zip(shifts, bits, strict=True)], axis=-1)
