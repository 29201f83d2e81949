"""Files of Gaussians by suffix: the plain PLY of 3DGS, PlayCanvas's compressed PLY, and SPZ; and the one of a run."""

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


def load_gaussians(path: str | Path) -> Gaussians:
    """The Gaussians of a file (`.ply`, `.compressed.ply`, `.spz`), or of a run folder, as numpy arrays.

    Raises:
        InputError: There is no such file, its suffix is not known, it is damaged, or a folder holds no finished run.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.is_dir():
        if not (path / "gaussians.ply").exists():
            hint = "its training has not finished" if (path / "manifest.json").exists() else "it is no run folder"
            raise InputError(f"{path}: holds no gaussians.ply; {hint}")
        path = path / "gaussians.ply"
    return format_of(path).read(path)


def save_gaussians(gaussians: Gaussians, path: str | Path) -> int:
    """Writes a file of the kind that the suffix says (`.ply`, `.compressed.ply`, `.spz`).

    Returns:
        How many Gaussians hold values that the format cannot reach, and were clipped to it; none in a `.ply`.

    Raises:
        InputError: The suffix is not known, the format cannot hold these Gaussians, or the file cannot be written.
    """
    return format_of(path).write(Path(path), gaussians)
