"""Stereo maps in the file of a run, and at the size of a photo."""

import numpy as np
import pytest
from fuzzing import fuzz_files

from gsjax.errors import InputError
from gsjax.stereo import StereoMap, read_stereo_maps, write_stereo_maps

DEPTH = np.array([[0, 2.5], [1.5, 0]], np.float32)
NORMALS = np.zeros((2, 2, 3), np.int8)
NORMALS[DEPTH > 0] = [0, 0, -127]


def test_maps_come_back_to_the_bit(tmp_path):
    assert read_stereo_maps(tmp_path) is None
    maps = {"a.png": StereoMap(DEPTH, NORMALS), "deep/b.jpg": StereoMap(2 * DEPTH, NORMALS)}
    write_stereo_maps(tmp_path, maps)
    read = read_stereo_maps(tmp_path)
    assert read is not None and list(read) == list(maps)
    for name, each in maps.items():
        np.testing.assert_array_equal(read[name].depth, each.depth)
        np.testing.assert_array_equal(read[name].normals, each.normals)
    larger = maps["a.png"].depth_at_size(4, 6)
    np.testing.assert_array_equal(larger, DEPTH.repeat(3, axis=0).repeat(2, axis=1), err_msg="of the nearest pixel")


def test_a_damaged_file_is_named(tmp_path):
    write_stereo_maps(tmp_path, {"a.png": StereoMap(DEPTH, NORMALS)})
    file = tmp_path / "stereo.npz"
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(InputError, match=str(file)):
        read_stereo_maps(tmp_path)
    np.savez(file, **{"a.png/depth": DEPTH})
    with pytest.raises(InputError, match=r"has no a\.png/normals"):
        read_stereo_maps(tmp_path)


@pytest.mark.parametrize(
    ("depth", "normals"),
    [
        (DEPTH, NORMALS[:1]),
        (DEPTH, NORMALS.astype(np.float32)),
        (np.where(DEPTH > 2, np.nan, DEPTH), NORMALS),
        (-DEPTH, NORMALS),
    ],
)
def test_arrays_that_are_no_depth_and_normals_are_refused(tmp_path, depth, normals):
    np.savez(tmp_path / "stereo.npz", **{"a.png/depth": depth, "a.png/normals": normals})
    with pytest.raises(InputError, match=r"stereo\.npz: damaged, a\.png has no depth and normals of one size"):
        read_stereo_maps(tmp_path)


def test_fuzz_stereo_maps(tmp_path):
    write_stereo_maps(tmp_path, {name: StereoMap(DEPTH, NORMALS) for name in ("a.png", "b.png")})

    def read():
        for each in (read_stereo_maps(tmp_path) or {}).values():
            each.depth_at_size(4, 6)

    assert all(fuzz_files(read, tmp_path / "stereo.npz", usual=150))
