import numpy as np
import pytest

from gsjax.errors import InputError
from gsjax.io.arrays import headers, read_arrays

A, B = np.arange(600, dtype=np.float32).reshape(20, 10, 3), np.zeros((4, 2), np.uint8)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_headers_are_those_of_what_is_read(tmp_path, save):
    save(tmp_path / "a.npz", a=A, b=B)
    np.save(tmp_path / "a.npy", A)
    for file, arrays in ((tmp_path / "a.npz", {"a": A, "b": B}), (tmp_path / "a.npy", {"": A})):
        read, seen = read_arrays(file), headers(file)
        assert list(read) == list(seen) == list(arrays)
        for key, array in arrays.items():
            np.testing.assert_array_equal(read[key], array)
            assert seen[key] == (array.shape, array.dtype)
    assert list(read_arrays(tmp_path / "a.npz", "b")) == list(headers(tmp_path / "a.npz", "b")) == ["b"]
    for function in (read_arrays, headers):
        with pytest.raises(InputError, match="a.npz: lacks c; it holds a, b"):
            function(tmp_path / "a.npz", "a", "c")


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_bytes_gone_wrong_are_one_line_naming_the_file(tmp_path, save):
    file = tmp_path / "a.npz"
    save(file, a=A, b=B)
    data = file.read_bytes()
    for at in range(0, len(data), max(1, len(data) // 40)):
        file.write_bytes(data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :])
        for function in (read_arrays, headers):
            try:
                function(file)
            except InputError as error:
                assert "a.npz" in str(error) and "\n" not in str(error)


def test_headers_do_not_read_what_follows(tmp_path):
    file = tmp_path / "a.npz"
    large = np.zeros((100, 100, 3), np.float32)  # more than is read at once
    np.savez(file, a=large)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    assert headers(file)["a"].shape == large.shape
    with pytest.raises(InputError, match=r"a.npz: cannot be read \(Bad CRC"):
        read_arrays(file)
