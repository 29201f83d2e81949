import os

import numpy as np
import pytest

from gsjax.io import temporary_files
from gsjax.io.temporary_files import ArraysOnDisk

RNG = np.random.default_rng(0)


def test_arrays_lie_on_the_disk_as_they_are_in_as_many_files_as_it_takes(tmp_path, monkeypatch):
    monkeypatch.setattr(temporary_files, "FILE", 4096)
    arrays = [
        RNG.integers(0, 256, (17, 19, 3), dtype=np.uint8),
        RNG.random((40, 50)) > 0.5,
        RNG.normal(size=(30, 100)).astype(np.float32)[:, ::2],  # larger than a file, and not in order
        RNG.integers(-127, 128, (7, 5, 3), dtype=np.int8),
        np.empty((0, 3), np.uint8),
    ]
    keep = ArraysOnDisk(tmp_path / "not" / "there")
    copies = [keep(array) for array in arrays]
    for array, one in zip(arrays, copies, strict=True):
        assert one.dtype == array.dtype and (isinstance(one, np.memmap) or not one.size)
        np.testing.assert_array_equal(one, array)
        assert keep(one) is one, "what lies there is not copied"
        assert one.ctypes.data % temporary_files.ALIGNED == 0 or not one.size
        if one.size:  # A copy in memory is still a memmap to numpy, and does not lie on the disk.
            assert np.may_share_memory(keep(one.copy()), keep._mapped)
    with pytest.raises(ValueError, match="read-only"):
        copies[0][0, 0, 0] = 1
    assert os.listdir(tmp_path) == [], "its files have no names, and go with the process"
