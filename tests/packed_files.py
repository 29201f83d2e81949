"""Gaussians and bytes for the tests of packed files: hard values, and SPZ files made by hand from its document."""

import struct

import numpy as np
import pytest
from hypothesis import strategies as st

from gsjax.gaussians import Gaussians
from gsjax.io.compressed_ply import read_compressed_ply, write_compressed_ply
from gsjax.io.sog import read_sog, write_sog
from gsjax.io.spz import read_spz, write_spz

READ_WRITE = {
    "g.sog": (read_sog, write_sog),
    "g.spz": (read_spz, write_spz),
    "g.compressed.ply": (read_compressed_ply, write_compressed_ply),
}
FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh_dc", "sh_rest")


def some_gaussians(count, degree, seed=0, extent=1.0, offset=0.0):
    """Gaussians with the hard values among them; `log_scales[:, 0]` numbers them in steps of 0.01."""
    rng = np.random.default_rng(seed)
    rest = (degree + 1) ** 2 - 1
    quats = rng.normal(size=(count, 4)) * 10 ** rng.uniform(-8, 8, (count, 1))
    quats[::7] = 0  # the identity
    quats[1::7] = [[-3, 3, 3, -3]]  # no component larger than the others
    logits = rng.normal(size=count) * 5
    logits[::5], logits[1::5], logits[2::5] = np.inf, -np.inf, 300
    log_scales = rng.normal(size=(count, 3)) * 8
    log_scales[:, 0] = number_scales(count)
    values = (
        rng.uniform(-1, 1, (count, 3)) * extent + offset,
        quats,
        log_scales,
        logits,
        rng.normal(size=(count, 1, 3)) * 2,
        rng.normal(size=(count, rest, 3)) * 2,
    )
    return Gaussians(*(value.astype(np.float32) for value in values))


def number_scales(count):
    return -6 + 0.01 * np.arange(count)


ROUNDING = 4e-7  # Of float32 results, relative to the numbers that they are made of.


def turns_apart(quats, others):
    """Largest difference of a component of unit quaternions, of either sign."""
    norm = np.linalg.norm(quats, axis=1, keepdims=True)
    unit = np.where(norm > 0, quats / np.where(norm > 0, norm, 1), [1, 0, 0, 0])
    signs = np.where(np.sum(unit * others, axis=1, keepdims=True) < 0, -1, 1)
    return np.abs(unit - signs * others).max(initial=0)


clouds = st.builds(
    some_gaussians,
    count=st.sampled_from([0, 1, 2, 255, 256, 257, 600]),
    degree=st.integers(0, 3),
    seed=st.integers(0, 2**32 - 1),
    extent=st.sampled_from([0.0, 1e-6, 1.0, 3e3, 1e6]),
    offset=st.sampled_from([0.0, -5e3, 4e6]),
)


DC_BYTES = [0, 128, 255]
REST = np.arange(-4, 5).reshape(3, 3) / 16  # degree 1: y, z, x; of red, green, blue


def by_hand(version, rotation):
    fixed = b"".join(round(value * 16).to_bytes(3, "little", signed=True) for value in (1.5, 0.25, -3.0))
    rest = REST * [[-1], [-1], [1]]  # y and z point the other way
    arrays = [
        fixed,
        bytes([51]),
        bytes(DC_BYTES),
        bytes([0, 128, 240]),
        rotation,
        bytes((128 + 128 * rest).astype(int).ravel().tolist()),
    ]
    return struct.pack("<IIIBBBB", 0x5053474E, version, 1, 1, 4, 1, 0), arrays


# (x, y, z, w) = (0.5, 0, 0, sqrt(3/4)): z is second and y first of those that a half turn about x turns round.
HALF = round(0.5 / np.sqrt(0.5) * 511)
ROTATIONS = {2: bytes([191, 128, 127]), 3: (3 << 30 | HALF << 20).to_bytes(4, "little")}


def version_4(header, arrays, extensions=b""):
    zstandard = pytest.importorskip("zstandard", reason="SPZ of version 4 needs zstandard")
    packed = [zstandard.ZstdCompressor().compress(array) for array in arrays if array]
    sizes = [
        struct.pack("<QQ", len(small), len(large)) for small, large in zip(packed, filter(None, arrays), strict=True)
    ]
    flags = bytes([header[14] | (2 if extensions else 0), len(packed)])
    head = header[:14] + flags + struct.pack("<I12x", 32 + len(extensions))
    return head + extensions + b"".join(sizes) + b"".join(packed)
