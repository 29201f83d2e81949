"""Compressed files of Gaussians: within their steps of what was written, and bytes made by hand from the documents."""

import gzip
import struct
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from packed_files import (
    DC_BYTES,
    FIELDS,
    READ_WRITE,
    REST,
    ROTATIONS,
    ROUNDING,
    by_hand,
    clouds,
    some_gaussians,
    turns_apart,
    version_4,
)
from scipy.special import expit
from tolerances import assert_close

from gsjax.errors import InputError
from gsjax.gaussians import SH_C0
from gsjax.io.compressed_ply import read_compressed_ply, write_compressed_ply
from gsjax.io.spz import read_spz, write_spz


def assert_near(read, quats, logit_opacities, bound):
    """Finite numbers of single precision; turns to half a step, and opacities to half of 1 / 255."""
    for field in FIELDS:
        assert getattr(read, field).dtype == np.float32 and np.isfinite(getattr(read, field)).all(), field
    assert turns_apart(quats, read.quats) <= bound
    assert np.abs(expit(read.logit_opacities) - expit(logit_opacities)).max(initial=0) <= 0.5 / 255 + 1e-6


@settings(max_examples=40, deadline=None)
@given(gaussians=clouds)
def test_spz_keeps_everything_to_its_steps(tmp_path_factory, gaussians):
    path = tmp_path_factory.mktemp("spz") / "g.spz"
    clipped = write_spz(path, gaussians)
    read = read_spz(path)
    assert all(getattr(read, field).shape == getattr(gaussians, field).shape for field in FIELDS)
    # The largest component of a turn follows from the other three.
    assert_near(read, gaussians.quats, gaussians.logit_opacities, 3.1 * np.sqrt(0.5) / 511 / 2)
    bits = gzip.decompress(path.read_bytes())[13]
    farthest = np.abs(gaussians.means.astype(np.float64)).max(initial=0)
    assert bits == 23 or farthest * 2 ** (bits + 1) > 2**23 - 1  # no finer step would reach the farthest
    assert np.abs(read.means - gaussians.means.astype(np.float64)).max(initial=0) <= 2.0**-bits / 2
    reach = {"log_scales": (-10, 95 / 16), "sh_dc": (-127.5 / 38.25, 127.5 / 38.25), "sh_rest": (-1, 127 / 128)}
    rest_steps = np.where(np.arange(gaussians.sh_rest.shape[1]) < 3, 1 / 16, 1 / 8)[:, None]
    steps = {"log_scales": 1 / 16, "sh_dc": 1 / 38.25, "sh_rest": rest_steps}
    for field, (low, high) in reach.items():
        expected = np.clip(getattr(gaussians, field).astype(np.float64), low, high)
        assert (np.abs(getattr(read, field) - expected) <= steps[field] / 2 + 10 * ROUNDING).all(), field
    outside = {field: beyond(gaussians, field, *reach[field]) for field in reach}
    far_outside = {field: beyond(gaussians, field, *reach[field], by=steps[field]) for field in reach}
    assert np.any([*far_outside.values()], axis=0).sum() <= clipped <= np.any([*outside.values()], axis=0).sum()


def beyond(gaussians, field, low, high, by=0.0):
    """`[N]` which of the Gaussians have a value that is out of reach."""
    values = getattr(gaussians, field).astype(np.float64)
    return ((values < low - by) | (values > high + by)).any(axis=tuple(range(1, values.ndim)))


@settings(max_examples=40, deadline=None)
@given(gaussians=clouds)
def test_a_compressed_ply_keeps_everything_to_the_steps_of_its_chunks(tmp_path_factory, gaussians):
    path = tmp_path_factory.mktemp("ply") / "g.compressed.ply"
    clipped = write_compressed_ply(path, gaussians)
    read = read_compressed_ply(path)
    count = len(gaussians.means)
    number = np.rint((read.log_scales[:, 0] + 6) / 0.01).astype(int)
    assert sorted(number) == list(range(count))
    expected = {field: getattr(gaussians, field)[number].astype(np.float64) for field in FIELDS}
    chunk = np.arange(count) // 256
    expected["log_scales"] = np.clip(expected["log_scales"], -20, 20)
    for field, levels in (("means", (2047, 1023, 2047)), ("log_scales", (2047, 1023, 2047)), ("sh_dc", (255,) * 3)):
        actual, values = getattr(read, field).reshape(-1, 3), expected[field].reshape(-1, 3)
        for index in range(-(-count // 256)):
            own = values[chunk == index]
            bound = np.ptp(own, axis=0) / levels / 2 + ROUNDING * np.abs(own).max() + 10 * ROUNDING
            assert (np.abs(actual[chunk == index] - own) <= bound).all(), field
    assert_near(read, expected["quats"], expected["logit_opacities"], 3.1 * np.sqrt(2) / 1023 / 2)
    assert (np.abs(read.sh_rest - np.clip(expected["sh_rest"], -4, 4)) <= 1 / 32).all()
    beyond = (np.abs(gaussians.log_scales) > 20).any(1) | (np.abs(gaussians.sh_rest) > 4).any((1, 2))
    beyond |= (np.abs(gaussians.sh_dc * SH_C0 + 0.5) > 4).any((1, 2))
    assert clipped == beyond.sum()


@pytest.mark.parametrize(("name", "pixel_filter"), [*zip(READ_WRITE, ["classic", "mip", "mip"], strict=True)])
def test_the_pixel_filter_and_what_was_packed_once_stay(tmp_path, name, pixel_filter):
    read, write = READ_WRITE[name]
    write(tmp_path / name, replace(some_gaussians(300, 2), pixel_filter=pixel_filter))
    once = read(tmp_path / name)
    assert once.pixel_filter == pixel_filter
    assert write(tmp_path / f"again.{name}", once) == 0
    again = read(tmp_path / f"again.{name}")
    if name.endswith("spz"):
        assert (tmp_path / name).read_bytes()[10:] == (tmp_path / f"again.{name}").read_bytes()[10:]
    assert_close(np.sort(again.logit_opacities), np.sort(once.logit_opacities))


# One Gaussian at (1.5, -0.25, 3) in the axes of a PLY, and its bytes by the document of the format.
MEAN, SCALES = [1.5, -0.25, 3.0], [-10.0, -2.0, 5.0]


@pytest.mark.parametrize(("version", "tolerance"), [(2, 8e-3), (3, 1e-3), (4, 1e-3)])
def test_spz_by_hand(tmp_path, version, tolerance):
    header, arrays = by_hand(version, ROTATIONS[min(version, 3)])
    extension = struct.pack("<II", 0xADBE0002, 4) + bytes(4)  # one that does not matter here
    old = header[:14] + bytes([3]) + header[15:] + b"".join(arrays) + extension
    whole = version_4(header, arrays, extension) if version == 4 else gzip.compress(old)
    (tmp_path / "g.spz").write_bytes(whole)
    read = read_spz(tmp_path / "g.spz")
    assert_close(read.means, np.float32([MEAN]))
    assert_close(read.log_scales, np.float32([SCALES]))
    assert_close(expit(read.logit_opacities), np.float32([0.2]))
    assert_close(read.sh_dc[0, 0] * 0.15 + 0.5, np.float32(DC_BYTES) / 255)
    assert_close(read.sh_rest[0], np.float32(REST))
    assert np.abs(read.quats - [[np.sqrt(0.75), 0.5, 0, 0]]).max() < tolerance
    assert read.pixel_filter == "mip"
    for length in range(0, len(whole), 9):
        (tmp_path / "g.spz").write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"g\.spz: (truncated|not an SPZ)"):
            read_spz(tmp_path / "g.spz")


def test_axes_of_its_own_in_an_spz_are_refused(tmp_path):
    axes = version_4(*by_hand(4, ROTATIONS[3]), extensions=struct.pack("<IIB", 0xADBE0003, 1, 6))
    (tmp_path / "g.spz").write_bytes(axes)
    with pytest.raises(InputError, match=r"g\.spz: states axes of its own"):
        read_spz(tmp_path / "g.spz")


@pytest.mark.parametrize("with_colors", [False, True])
def test_a_compressed_ply_by_hand(tmp_path, with_colors):
    """Two Gaussians at the corners of their chunk, colours between 0 and 1 where the chunk tells no bounds of them."""
    ends = np.float32([[0, 1, 2], [4, 5, 6], [-3, -3, -3], [-1, -2, -3]] + with_colors * [[0, 0, 0], [1, 0.5, 2]])
    names = [f"{end}_{axis}" for end in ("min", "max") for axis in "xyz"]
    names += [f"{end}_scale_{axis}" for end in ("min", "max") for axis in "xyz"]
    names += [f"{end}_{axis}" for end in ("min", "max") for axis in "rgb"] * with_colors
    half = round((0.5 * np.sqrt(0.5) + 0.5) * 1023)
    rows = [
        [0, 1 << 30 | 512 << 20 | 512 << 10 | 512, 2**32 - 1, 0xFF00FF33],
        [2**32 - 1, half << 20 | 512 << 10 | 512, 0, 0x00FF0033],
    ]
    packed = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
    lines = ["ply", "format binary_little_endian 1.0", "element chunk 1", *(f"property float {n}" for n in names)]
    lines += ["element vertex 2", *(f"property uint {n}" for n in packed)]
    lines += ["element sh 2", *(f"property uchar f_rest_{i}" for i in range(9)), "end_header", ""]
    rest = np.uint8([[0, 1, 127, 128, 129, 130, 131, 254, 255]] * 2)
    body = ends.tobytes() + np.array(rows, "<u4").tobytes() + rest.tobytes()
    (tmp_path / "g.compressed.ply").write_bytes("\n".join(lines).encode() + body)
    read = read_compressed_ply(tmp_path / "g.compressed.ply")
    assert_close(read.means, np.float32([[0, 1, 2], [4, 5, 6]]))
    assert_close(read.log_scales, np.float32([[-1, -2, -3], [-3, -3, -3]]))
    assert_close(expit(read.logit_opacities), np.float32([0.2, 0.2]))
    high = ends[5] if with_colors else np.ones(3)
    assert_close(read.sh_dc[:, 0] * np.float32(SH_C0) + 0.5, np.float32([[1, 0, 1], [0, 1, 0]] * high))
    assert np.abs(read.quats - [[0, 1, 0, 0], [np.sqrt(0.75), 0.5, 0, 0]]).max() < 1.5e-3
    channel = [-4, -4 + 3 / 64, -1 / 64, 1 / 64, 3 / 64, 5 / 64, 7 / 64, 4 - 3 / 64, 4]
    assert_close(read.sh_rest, np.float32([np.reshape(channel, (3, 3)).T] * 2))


@pytest.mark.parametrize("name", READ_WRITE)
def test_huge_values_are_clipped_without_a_warning(tmp_path, name):
    read, write = READ_WRITE[name]
    gaussians = some_gaussians(4, 1)
    for field in ("quats", "log_scales", "sh_rest", "sh_dc"):
        getattr(gaussians, field)[:] *= np.float32(1e38) / np.abs(getattr(gaussians, field)).max()
    assert write(tmp_path / name, gaussians) == (0 if name == "g.sog" else 4)  # whose codebooks hold any value
    assert all(np.isfinite(getattr(read(tmp_path / name), field)).all() for field in FIELDS)


@pytest.mark.parametrize("name", READ_WRITE)
@pytest.mark.parametrize(("count", "number_far", "offset"), [(50, 1, 0.0), (3000, 5, 300.0)])
def test_far_gaussians_take_no_precision_from_others(tmp_path, name, count, number_far, offset):
    """The others are as they are without them, but for the order; the far ones are counted and keep their direction."""
    read, write = READ_WRITE[name]
    gaussians = some_gaussians(count, 0, offset=offset)
    # All of it is within reach but the means, and scales number them whatever their order.
    gaussians.log_scales[:] = -6 + 0.1 * np.stack(np.unravel_index(np.arange(count), (1, 64, 64)), axis=1)
    gaussians.sh_dc[:] = 0
    near = replace(gaussians, means=gaussians.means.copy())
    far = np.arange(number_far) * (count // number_far)
    directions = np.random.default_rng(1).normal(size=(number_far, 3))
    gaussians.means[far] = directions * 10.0 ** np.linspace(4, 30, number_far)[:, None]
    assert write(tmp_path / name, near) == 0
    assert write(tmp_path / f"far_{name}", gaussians) == number_far
    others = np.setdiff1d(np.arange(count), far)
    errors = []
    for file in (name, f"far_{name}"):
        result = read(tmp_path / file)
        places = np.argsort(np.rint((result.log_scales[:, 1:] + 6) / 0.1) @ [64, 1])
        errors.append(np.abs(result.means[places[others]] - near.means[others]).mean())
        came_in = result.means[places[far]] - offset
    assert errors[1] < 1.5 * errors[0] + 1e-6 * (offset > 0)
    assert (np.abs(came_in).max(axis=1) < 4).all()
    lengths = np.linalg.norm(came_in, axis=1) * np.linalg.norm(directions, axis=1)
    assert (np.sum(came_in * directions, axis=1) / lengths > 0.9).all()


@pytest.mark.parametrize("name", READ_WRITE)
def test_what_no_file_can_hold_is_refused_by_name(tmp_path, name):
    _, write = READ_WRITE[name]
    for field in FIELDS:
        broken = some_gaussians(9, 1)
        getattr(broken, field)[4, ...] = np.nan
        with pytest.raises(InputError, match=rf"cannot write .*{name}: {field} of 1 of 9 Gaussians not finite"):
            write(tmp_path / name, broken)
    with pytest.raises(InputError, match=r"up to degree 3, not 4; sh_degree=3 leaves out the rest"):
        write(tmp_path / name, some_gaussians(9, 4))
    with pytest.raises(InputError, match=r"g.spz: a mean is at 9e\+06, SPZ reaches 8388607"):
        write_spz(tmp_path / "g.spz", some_gaussians(3, 0, offset=9e6))
    assert not list(tmp_path.iterdir())


def test_what_is_no_spz_is_named(tmp_path):
    header, arrays = by_hand(3, ROTATIONS[3])

    def changed(place, value):
        return gzip.compress(header[:place] + bytes([value]) + header[place + 1 :] + b"".join(arrays))

    for data, message in (
        (b"ply\nformat", "not an SPZ file"),
        (gzip.compress(b"short"), "truncated, it ends within the header"),
        (changed(4, 9), "SPZ of version 9, not one of 2, 3"),
        (changed(8, 2), "truncated, 2 Gaussians need"),
        (changed(8, 1)[:30] + b"xxxx" + changed(8, 1)[34:], r"truncated or damaged \("),
    ):
        (tmp_path / "g.spz").write_bytes(data)
        with pytest.raises(InputError, match=rf"g.spz: {message}"):
            read_spz(tmp_path / "g.spz")


def bomb(version, more=10**8):
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
    ("version", "message"), [(3, "continues for more than 1048576 bytes"), (4, "array 1 of 6 is not")]
)
def test_an_spz_of_more_than_memory_holds_is_refused_in_little_memory(tmp_path, version, message):
    (tmp_path / "g.spz").write_bytes(bomb(version))
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=f"g.spz: .*{message}"):
            read_spz(tmp_path / "g.spz")
        assert tracemalloc.get_traced_memory()[1] < 2e7
    finally:
        tracemalloc.stop()


def test_gsplats_compressed_ply_of_degree_0(tmp_path):
    """It names the element of the harmonics, which then has no columns."""
    own, other = tmp_path / "g.compressed.ply", tmp_path / "h.compressed.ply"
    write_compressed_ply(own, some_gaussians(300, 0))
    other.write_bytes(own.read_bytes().replace(b"end_header", b"element sh 300\nend_header"))
    for field in FIELDS:
        np.testing.assert_array_equal(*(getattr(read_compressed_ply(file), field) for file in (own, other)))


def test_what_is_no_compressed_ply_is_named(tmp_path):
    path = tmp_path / "g.compressed.ply"
    write_compressed_ply(path, some_gaussians(3, 1))
    whole = path.read_bytes()
    for old, new, message in (
        (b"element chunk 1", b"element chunk 0", "3 Gaussians do not go with 0 chunks and 3 harmonics"),
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
