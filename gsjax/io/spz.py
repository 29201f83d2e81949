"""SPZ, Niantic's compressed Gaussians (https://github.com/nianticlabs/spz): written as version 3, read as 2, 3 and 4.

Version 3 is what the viewers of today read: those built on three.js know no later one. A header of 16 bytes and the
arrays of `_Header.layout`, one after another, are compressed as a whole by gzip; version 4 has a header of 32 bytes and
compresses each array by zstandard. The axes are x right, y up, z back, half a turn about x from those of a PLY.
"""

import gzip
import io
import math
import struct
import zlib
from dataclasses import replace
from itertools import accumulate, pairwise
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.io import packing
from gsjax.io.files import atomic_path, read_bytes
from gsjax.io.machine import require_memory
from gsjax.io.packages import require

_MAGIC = 0x5053474E  # The bytes NGSP.
_HEADER = struct.Struct("<IIIBBBB")  # magic, version, Gaussians, degree, fractional bits, flags, number of arrays (4)
_ANTIALIASED, _EXTENDED = 1, 2  # flags
_OTHER_AXES = 0xADBE0003  # The extension SPZ_ADOBE_coordinate_system.
_REACH = 256.0  # Within so many times the spread of nine tenths positions are kept, to 3e-5 of that spread.
_MOST_FIXED = 2**23 - 1  # Positions have 24 bits with the sign.
_MOST_RATIO = 1100  # What gzip makes of a byte at the most (1032), rounded up.
_MOST_EXTENSIONS = 2**20  # bytes behind the Gaussians
_BYTES_PER_BYTE = 20  # of memory, of an unpacked one: it becomes a float64 and is turned
_DC_STEP = 1 / (0.15 * 255)
_ROTATION_STEP = math.sqrt(0.5) / 511
_REST_STEPS = (1 / 16, 1 / 8)  # degree 1, and the higher ones: what Niantic's writer leaves of 8 bits by default


class _Header(NamedTuple):
    version: int
    count: int
    degree: int
    fractional_bits: int
    flags: int

    def layout(self) -> tuple[int, ...]:
        """Bytes a Gaussian of positions, opacities, colours, scales, rotations, harmonics."""
        return 9, 1, 3, 3, 3 if self.version == 2 else 4, 3 * ((self.degree + 1) ** 2 - 1)


def write_spz(path: str | Path, gaussians: Gaussians) -> int:
    """Writes Gaussians as SPZ version 3. Positions get as many fractional bits as the farthest leaves, 23 at most.

    The few that are so far out that no other had its precision come in first (`pull_in_outliers`).

    The steps: logs of scales 1/16, from -10 to 95/16; opacities 1/255; degree 0 0.0261, from -3.33 to 3.33; degree 1
    1/16, higher ones 1/8, from -1 to 127/128; quaternions 0.0014. The mip filter is the format's flag for antialiasing.

    Returns:
        How many Gaussians hold values that the format cannot reach.
    """
    packed, clipped = spz_bytes(gaussians, path)
    with atomic_path(path) as temporary:
        temporary.write_bytes(packed)
    return clipped


def spz_bytes(gaussians: Gaussians, path: str | Path) -> tuple[bytes, int]:
    """The file that `write_spz` writes, and what it returns; `path` is what messages call it.

    Raises:
        InputError: Values are not finite, the mass is beyond 2^23 scene units, or harmonics are of degree 4.
    """
    packing.check_packable(path, gaussians)
    turned = half_turned(jax.tree.map(lambda values: np.asarray(values, np.float64), gaussians))
    means, far = packing.pull_in_outliers(np.ascontiguousarray(turned.means), _REACH)
    farthest = float(np.abs(means).max(initial=2.0**-23))
    bits = min(23, math.floor(math.log2(_MOST_FIXED / farthest)))
    if bits < 0:
        raise InputError(f"cannot write {path}: a mean is at {farthest:.3g}, SPZ reaches {_MOST_FIXED}")
    steps = np.where(np.arange(turned.sh_rest.shape[1]) < 3, *_REST_STEPS)[:, None]
    fixed = np.rint(means * 2**bits).astype("<i4")
    numbers = {
        "colors": turned.sh_dc[:, 0] / _DC_STEP + 127.5,
        "scales": (turned.log_scales + 10) * 16,
        "rest": np.rint(turned.sh_rest / steps) * steps * 128 + 128,
    }
    bytes_ = {name: np.clip(np.rint(values), 0, 255).astype(np.uint8) for name, values in numbers.items()}
    largest, three = packing.smallest_three(np.roll(packing.unit_quats(turned.quats), -1, axis=1))
    magnitudes = np.rint(np.abs(three) / _ROTATION_STEP).astype(np.uint32) | (three < 0).astype(np.uint32) << 9
    rotations = largest.astype(np.uint32) << 30 | magnitudes[:, 0] << 20 | magnitudes[:, 1] << 10 | magnitudes[:, 2]
    flags = _ANTIALIASED if gaussians.pixel_filter == "mip" else 0
    arrays = (
        fixed.view(np.uint8).reshape(-1, 4)[:, :3],
        packing.opacity_bytes(turned.logit_opacities),
        bytes_["colors"],
        bytes_["scales"],
        rotations.astype("<u4"),
        bytes_["rest"],
    )
    header = _HEADER.pack(_MAGIC, 3, len(fixed), turned.sh_degree, bits, flags, 0)
    body = header + b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    # A value that rounds to the last step is reached, and so is 1 of a harmonic, whose last step is one of 127/128.
    tops = {"colors": 255.5, "scales": 255.5, "rest": 256}
    beyond = [((v < -0.5) | (v > tops[name])).any(axis=tuple(range(1, v.ndim))) for name, v in numbers.items()]
    return gzip.compress(body, 6, mtime=0), int(np.any([far, *beyond], axis=0).sum())


def read_spz(path: str | Path) -> Gaussians:
    """Reads SPZ of version 2, 3 or 4, any degree 0-4, as numpy float32 arrays in the axes of a PLY.

    Opacities of 0 and 255 get finite logits, a quarter of a step within 0 and 1. Extensions are left out.
    """
    path = Path(path)
    data = read_bytes(path)
    if data[:2] == b"\x1f\x8b":
        header, arrays, extensions = _read_gzip(path, data)
    elif data[:4] == _MAGIC.to_bytes(4, "little"):
        header, arrays, extensions = _read_zstandard(path, data)
    else:
        raise InputError(f"{path}: not an SPZ file")
    if header.flags & _EXTENDED and _OTHER_AXES in _extension_types(extensions):
        raise InputError(f"{path}: states axes of its own (SPZ_ADOBE_coordinate_system), which are not read")
    count, bands = header.count, header.layout()[-1] // 3
    positions, opacities, colors, scales, rotations, rest = (np.frombuffer(array, np.uint8) for array in arrays)
    fixed = np.zeros((3 * count, 4), np.uint8)
    fixed[:, 1:] = positions.reshape(-1, 3)
    means = np.ldexp((fixed.view("<i4")[:, 0] >> 8).astype(np.float64), -header.fractional_bits)
    turned = Gaussians(
        means=means.reshape(count, 3),
        quats=_first_three(rotations) if header.version == 2 else _smallest_three(rotations),
        log_scales=scales.reshape(count, 3) / 16 - 10,
        logit_opacities=packing.logits_of_bytes(opacities),
        sh_dc=(colors.reshape(count, 1, 3) - 127.5) * _DC_STEP,
        sh_rest=rest.reshape(count, bands, 3) / 128 - 1,
        pixel_filter="mip" if header.flags & _ANTIALIASED else "classic",
    )
    return jax.tree.map(lambda values: values.astype(np.float32), half_turned(turned))


def half_turned(gaussians: Gaussians) -> Gaussians:
    """Gaussians turned by half a turn about x: from the axes of a PLY to those of SPZ, and back.

    A PLY has x right, y down, z forward; SPZ has x right, y up, z back.
    A harmonic of degree l and order m keeps its value but for the sign (-1)^(l+m), and once more where m is below 0.
    """
    degrees = range(1, gaussians.sh_degree + 1)
    signs = [
        (-1) ** (degree + order) * (-1 if order < 0 else 1)
        for degree in degrees
        for order in range(-degree, degree + 1)
    ]
    return replace(
        gaussians,
        means=gaussians.means * np.array([1, -1, -1], gaussians.means.dtype),
        quats=gaussians.quats * np.array([1, 1, -1, -1], gaussians.quats.dtype),
        sh_rest=gaussians.sh_rest * np.array(signs, gaussians.sh_rest.dtype)[:, None],
    )


def _checked(path: Path, head: bytes, versions: tuple[int, ...]) -> _Header:
    """The header, where it is one of an SPZ that is read here."""
    if len(head) < _HEADER.size:
        raise InputError(f"{path}: truncated, it ends within the header")
    magic, *numbers, _ = _HEADER.unpack_from(head)
    header = _Header(*numbers)
    if magic != _MAGIC:
        raise InputError(f"{path}: not an SPZ file")
    if header.version not in versions:
        raise InputError(f"{path}: SPZ of version {header.version}, not one of {', '.join(map(str, versions))}")
    if header.degree > 4:
        raise InputError(f"{path}: harmonics of degree {header.degree}, above 4")
    return header


def _read_gzip(path: Path, data: bytes) -> tuple[_Header, list[bytes], bytes]:
    """Versions 2 and 3: the arrays one after another, extensions behind them."""
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as unpacking:
            header = _checked(path, unpacking.read(_HEADER.size), (2, 3))
            ends = list(accumulate((header.count * width for width in header.layout()), initial=0))
            if ends[-1] > _MOST_RATIO * len(data):
                raise InputError(f"{path}: truncated, {header.count} Gaussians need {ends[-1]} bytes unpacked")
            require_memory(f"{path}: {header.count} Gaussians", _BYTES_PER_BYTE * ends[-1])
            body = unpacking.read(ends[-1] + _MOST_EXTENSIONS + 1)  # No more, however much there is.
    except (EOFError, OSError, zlib.error) as error:
        raise InputError(f"{path}: truncated or damaged ({error})") from error
    if len(body) < ends[-1]:
        raise InputError(f"{path}: truncated, {header.count} Gaussians need {ends[-1]} bytes, it has {len(body)}")
    if len(body) > ends[-1] + _MOST_EXTENSIONS:
        raise InputError(f"{path}: continues for more than {_MOST_EXTENSIONS} bytes after its {header.count} Gaussians")
    return header, [body[start:end] for start, end in pairwise(ends)], body[ends[-1] :]


def _read_zstandard(path: Path, data: bytes) -> tuple[_Header, list[bytes], bytes]:
    """Version 4: extensions, sizes of the arrays that are not empty (8 bytes packed, 8 unpacked), the arrays."""
    header, start = _checked(path, data, (4,)), 32
    sizes = [header.count * width for width in header.layout()]
    filled = [size for size in sizes if size]
    if data[15] != len(filled) or len(data) < start:
        raise InputError(f"{path}: truncated or damaged, {data[15]} arrays instead of {len(filled)}")
    table = int.from_bytes(data[16:20], "little")
    place = table + 16 * len(filled)
    if table < start or len(data) < place:
        raise InputError(f"{path}: truncated or damaged, it ends within the table of its arrays")
    zstandard = require("zstandard")
    require_memory(f"{path}: {header.count} Gaussians", _BYTES_PER_BYTE * sum(sizes))
    unpacked = []
    for index, size in enumerate(filled):
        packed, promised = struct.unpack_from("<QQ", data, table + 16 * index)
        try:
            reader = zstandard.ZstdDecompressor().stream_reader(data[place : place + packed])
            unpacked.append(reader.read(size + 1))  # No more, whatever the array's own header promises.
        except zstandard.ZstdError as error:
            raise InputError(f"{path}: truncated or damaged ({error})") from error
        if not promised == size == len(unpacked[-1]):
            raise InputError(f"{path}: truncated or damaged, array {index + 1} of {len(filled)} is not whole")
        place += packed
    arrays = iter(unpacked)
    return header, [next(arrays) if size else b"" for size in sizes], data[start:table]


def _extension_types(records: bytes) -> set[int]:
    """The types of records of a type (4 bytes), a length (4 bytes) and so many bytes."""
    types, place = set(), 0
    while place + 8 <= len(records):
        kind, length = struct.unpack_from("<II", records, place)
        types.add(kind)
        place += 8 + length
    return types


def _smallest_three(packed: np.ndarray) -> np.ndarray:
    """`[N, 4]` quaternions of 2 bits for the largest of (x, y, z, w), and a sign and 9 bits for each of the others."""
    codes = packed.view("<u4")[:, None] >> np.array([20, 10, 0], np.uint32) & 1023
    three = (codes & 511) * _ROTATION_STEP * np.where(codes > 511, -1, 1)
    return np.roll(packing.of_smallest_three(packed.view("<u4") >> 30, three), 1, axis=1)


def _first_three(packed: np.ndarray) -> np.ndarray:
    """`[N, 4]` quaternions of x, y and z in 8 bits each, w not below 0."""
    x, y, z = packed.reshape(-1, 3).T / 127.5 - 1
    return np.stack([np.sqrt(np.maximum(0, 1 - x * x - y * y - z * z)), x, y, z], axis=-1)
