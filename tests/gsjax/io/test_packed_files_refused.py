"""Packed files of Gaussians that are refused in one line: cut, foreign, or asking for more than there is."""

import gzip
import struct
import tracemalloc

import numpy as np
import pytest
from packed_files import (
    FIELDS,
    READ_WRITE,
    ROTATIONS,
    by_hand,
    some_gaussians,
    version_4,
)

from gsjax.errors import InputError
from gsjax.io.compressed_ply import read_compressed_ply, write_compressed_ply
from gsjax.io.spz import read_spz, write_spz

MILLIONS = 4_000_000_000  # Gaussians that a header asks for


@pytest.mark.parametrize("name", READ_WRITE)
def test_what_no_file_can_hold_is_refused_by_name(tmp_path, name):
    _, write = READ_WRITE[name]
    for field in FIELDS:
        broken = some_gaussians(9, 1)
        getattr(broken, field)[4, ...] = np.nan
        with pytest.raises(InputError, match=rf"cannot write .*{name}: {field} of 1 of 9 Gaussians not finite"):
            write(tmp_path / name, broken)
    with pytest.raises(InputError, match=r"up to degree 3, not 4; --sh-degree 3 leaves out the rest"):
        write(tmp_path / name, some_gaussians(9, 4))
    assert not list(tmp_path.iterdir())


def test_means_beyond_spz_are_refused(tmp_path):
    gaussians = some_gaussians(3, 0)
    gaussians.means[:, 2] = -9e6
    with pytest.raises(InputError, match=r"g.spz: a mean lies at 9e\+06, SPZ reaches 8388607"):
        write_spz(tmp_path / "g.spz", gaussians)


@pytest.mark.parametrize("name", READ_WRITE)
def test_truncated_files_are_one_line(tmp_path, name):
    read, write = READ_WRITE[name]
    write(tmp_path / name, some_gaussians(300, 1))
    whole = (tmp_path / name).read_bytes()
    for share in (0, 0.001, 0.01, 0.2, 0.9, 0.999):
        (tmp_path / name).write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match=rf"{name}: (truncated|not an? |PLY header)") as error:
            read(tmp_path / name)
        assert "\n" not in str(error.value)


def changed(place, value):
    header, arrays = by_hand(3, ROTATIONS[3])
    return gzip.compress(header[:place] + bytes([value]) + header[place + 1 :] + b"".join(arrays))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"ply\nformat", "not an SPZ file"),
        (gzip.compress(b"something else of some length"), "not an SPZ file"),
        (gzip.compress(b"short"), "truncated, it ends within the header"),
        (changed(4, 1), "SPZ of version 1, not one of 2, 3"),
        (changed(4, 9), "SPZ of version 9, not one of 2, 3"),
        (changed(12, 5), "harmonics of degree 5, above 4"),
        (changed(8, 2), "truncated, 2 Gaussians need"),
        (changed(8, 1)[:30] + b"xxxx" + changed(8, 1)[34:], r"truncated or damaged \("),
    ],
    # Compressed bytes tell the time; workers that began in two seconds would not agree on the tests.
    ids=lambda value: "" if isinstance(value, bytes) else value,
)
def test_what_is_no_spz_is_named(tmp_path, data, message):
    (tmp_path / "g.spz").write_bytes(data)
    with pytest.raises(InputError, match=rf"g.spz: {message}"):
        read_spz(tmp_path / "g.spz")


def bomb(version, more):
    """A file of a few kilobytes that becomes a hundred megabytes, behind or instead of its one Gaussian."""
    header, arrays = by_hand(version, ROTATIONS[3])
    if version == 3:
        return gzip.compress(header + b"".join(arrays) + bytes(more))
    zstandard = pytest.importorskip("zstandard", reason="SPZ of version 4 needs zstandard")
    whole = version_4(header, arrays)
    packed = zstandard.ZstdCompressor().compress(bytes(more))
    place = 32 + 16 * len(arrays)
    first = struct.unpack_from("<Q", whole, 32)[0]
    return whole[:32] + struct.pack("<Q", len(packed)) + whole[40:place] + packed + whole[place + first :]


@pytest.mark.parametrize(
    ("version", "message"), [(3, "goes on for more than 1048576 bytes"), (4, "array 1 of 6 is not")]
)
def test_an_spz_that_inflates_without_end_is_refused_in_little_memory(tmp_path, version, message):
    (tmp_path / "g.spz").write_bytes(bomb(version, 10**8))
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=f"g.spz: .*{message}"):
            read_spz(tmp_path / "g.spz")
        assert tracemalloc.get_traced_memory()[1] < 2e7
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("version", [3, 4])
def test_an_spz_that_asks_for_a_hundred_gigabytes_is_refused(tmp_path, version):
    header, arrays = by_hand(version, ROTATIONS[3])
    header = header[:8] + struct.pack("<I", MILLIONS) + header[12:]
    whole = gzip.compress(header + b"".join(arrays)) if version == 3 else version_4(header, arrays)
    (tmp_path / "g.spz").write_bytes(whole)
    fault = "truncated, 4000000000 Gaussians need" if version == 3 else "4000000000 Gaussians takes .* GiB of memory"
    with pytest.raises(InputError, match=f"g.spz: {fault}"):
        read_spz(tmp_path / "g.spz")


def test_what_is_no_compressed_ply_is_named(tmp_path):
    path = tmp_path / "g.compressed.ply"
    write_compressed_ply(path, some_gaussians(3, 1))
    whole = path.read_bytes()
    for old, new, message in (
        (b"element chunk 1", b"element chunk 0", "3 Gaussians do not go with 0 chunks and 3 harmonics"),
        (b"min_scale_x", b"min_scale_w", "not a compressed PLY of Gaussians"),
        (b"packed_color", b"packed_light", "not a compressed PLY of Gaussians"),
        (b"uint packed_rotation", b"float packed_rotation", "not a compressed PLY of Gaussians"),
        (b"f_rest_8", b"f_more_8", r"has 8 columns f_rest_\*"),
    ):
        path.write_bytes(whole.replace(old, new))
        with pytest.raises(InputError, match=rf"g.compressed.ply: {message}"):
            read_compressed_ply(path)
    body = whole.index(b"end_header\n") + len(b"end_header\n")
    path.write_bytes(whole[:body] + np.float32(np.nan).tobytes() + whole[body + 4 :])
    with pytest.raises(InputError, match=r"g.compressed.ply: bounds of a chunk are not finite"):
        read_compressed_ply(path)
