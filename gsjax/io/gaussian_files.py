"""Files of Gaussians by suffix: the plain PLY of 3DGS, PlayCanvas's compressed PLY, and SPZ."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.io import compressed_ply, ply, spz


class Format(NamedTuple):
    """How a kind of file is read, and written; writing tells how many Gaussians it had to clip to what it can hold."""

    read: Callable[[Path], Gaussians]
    write: Callable[[Path, Gaussians], int]


def _write_plain(path: Path, gaussians: Gaussians) -> int:
    ply.write_gaussians(path, gaussians)
    return 0


FORMATS = {
    ".compressed.ply": Format(compressed_ply.read_compressed_ply, compressed_ply.write_compressed_ply),
    ".ply": Format(ply.read_gaussians, _write_plain),
    ".spz": Format(spz.read_spz, spz.write_spz),
}


def format_of(path: str | Path) -> Format:
    """The format that a file's suffix, in capitals or not, tells; the longest that fits.

    Raises:
        InputError: The suffix is none of `FORMATS`.
    """
    for suffix, form in FORMATS.items():
        if Path(path).name.lower().endswith(suffix):
            return form
    raise InputError(f"{path}: files of Gaussians end in {', '.join(FORMATS)}")
