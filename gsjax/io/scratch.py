"""Arrays on the disk instead of in memory: what is read of them is in memory only while there is room."""

import tempfile
import weakref
from pathlib import Path
from typing import IO

import numpy as np

from gsjax.io.files import unwritable

FILE = 1 << 30  # bytes of a file, which is mapped as a whole: so few are open at a time
ALIGNED = 64  # bytes, as jax wants arrays that it reads where they lie


class Scratch:
    """Lays arrays into files without a name, which are gone with the process, however it ends."""

    def __init__(self, folder: Path):
        """Files on the disk of `folder`, or of the nearest folder above it that is there."""
        self.folder = next(each for each in (folder, *folder.absolute().parents) if each.is_dir())
        self._file, self._mapped, self._taken = None, np.empty(0, np.uint8), 0

    def __call__(self, array: np.ndarray) -> np.ndarray:
        """The same array as it lies on the disk, read only; one that lies on a disk already is not copied.

        Raises:
            InputError: The disk is full.
        """
        if (isinstance(array, np.memmap) and array.mode is not None) or not array.nbytes:  # Copies have no mode.
            return array
        try:
            file = self._file_with_room(array.nbytes)
            begin = file.seek(self._taken)
            # Not stored through the map, where a full disk would kill the process.
            file.write(np.ascontiguousarray(array).data)
            file.flush()
        except OSError as error:
            raise unwritable(self.folder, error) from error
        self._taken = -(-(begin + array.nbytes) // ALIGNED) * ALIGNED
        return self._mapped[begin : begin + array.nbytes].view(array.dtype).reshape(array.shape)

    def _file_with_room(self, size: int) -> IO[bytes]:
        if self._file is None or self._taken + size > len(self._mapped):
            self._file = tempfile.TemporaryFile(dir=self.folder)  # noqa: SIM115 (closed with the scratch)
            weakref.finalize(self, self._file.close)
            self._file.truncate(max(FILE, size))  # Bytes that nobody writes take no place.
            self._mapped, self._taken = np.memmap(self._file, np.uint8, mode="r"), 0
        return self._file
