"""Arrays in `.npy` and `.npz` files: read whole, or their headers alone."""

import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from gsjax.errors import InputError
from gsjax.io.machine import require_memory

_ALWAYS_ROOM = 2**26  # bytes


Header = tuple[tuple[int, ...], np.dtype]
"""The shape and the type of an array."""


def headers(file: Path, *keys: str) -> dict[str, Header]:
    """Shapes and types of the named arrays of an `.npz` (all where none is named), or of an `.npy` under the key "".

    Raises:
        InputError: The file is damaged or lacks one; names the file.
    """
    with _opened(file) as handle:
        if file.suffix == ".npy":
            return {"": _header(handle)}
        with zipfile.ZipFile(handle) as archive:
            present = [name.removesuffix(".npy") for name in archive.namelist()]
            if missing := [key for key in keys if key not in present]:
                raise InputError(f"{file}: lacks {', '.join(missing)}; it holds {', '.join(present)}")
            return {key: _header(archive.open(f"{key}.npy")) for key in keys or present}


def read_arrays(file: Path, *keys: str) -> dict[str, np.ndarray]:
    """The arrays that `headers` describes; raises as it does, and where they have no room in memory."""
    for key, (shape, dtype) in headers(file, *keys).items():
        size = math.prod(shape) * dtype.itemsize
        if size > _ALWAYS_ROOM:
            require_memory(f"{file}: {key or 'its array'}, of shape {list(shape)},", size)
    with _opened(file) as handle:
        if file.suffix == ".npy":
            return {"": np.load(handle)}
        with np.load(handle) as archive:
            return {key: archive[key] for key in keys or archive}


@contextmanager
def _opened(file: Path) -> Iterator[IO[bytes]]:
    try:
        with file.open("rb") as handle:
            yield handle
    except InputError:
        raise
    except Exception as error:  # Archives, decoders and numpy's headers raise whatever the broken bytes lead to.
        reason = str(error).splitlines()[0] if str(error) else "it ends too soon"
        raise InputError(f"{file}: cannot be read ({reason})") from error


def _header(handle: IO[bytes]) -> Header:
    version = np.lib.format.read_magic(handle)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(handle)
    return shape, dtype
