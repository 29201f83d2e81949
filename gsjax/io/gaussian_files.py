"""Files of Gaussians by suffix: 3DGS's plain PLY, PlayCanvas's compressed PLY and SOG, and SPZ; and that of a run.

The compressed ones have few bits for positions and sizes. Gaussians that are far off their origin, or are very small or
large in their units, are stored in local coordinates (`gsjax.scene.similarity`), which a second file states:
`garden.spz.similarity.json`.
"""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians, is_alive, take
from gsjax.io import compressed_ply, json_files, ply, sog, spz
from gsjax.io.files import atomic_path, finish_replacement
from gsjax.io.georeference_files import state_beside
from gsjax.scene.georeference import UNPLACED, Place
from gsjax.scene.similarity import IDENTITY, Similarity, loses_in_float32, of_points, parse_similarity

USUAL_SCALES = 1 / 64, 64.0  # Of a similarity: a compressed file needs no other units of its own.
_ABOUT = "local = scale * (world - center); the file next to this one has local coordinates"


class Format(NamedTuple):
    """How a kind of file is read, and written; writing returns how many Gaussians it clipped to what it can hold."""

    read: Callable[[Path], Gaussians]
    write: Callable[[Path, Gaussians, Place], int]


def _stated_beside(write: Callable[[Path, Gaussians], int]) -> Callable[[Path, Gaussians, Place], int]:
    """Writing to a format that cannot hold the place, which a second file then states."""

    def stated(path: Path, gaussians: Gaussians, place: Place) -> int:
        clipped = write(path, gaussians)
        state_beside(path, place)
        return clipped

    return stated


def stored_similarity(path: str | Path) -> Similarity:
    """To the coordinates in a compressed file from those of its Gaussians, as the JSON file next to it states."""
    file = _beside(path)
    return parse_similarity(json_files.read(file), file) if file.exists() else IDENTITY


def _local(form: Format) -> Format:
    """A format whose files hold local coordinates where they have to."""

    def read(path: Path) -> Gaussians:
        similarity = stored_similarity(path)
        gaussians = form.read(path)
        return gaussians if similarity.is_identity else similarity.gaussians_to_world(gaussians)

    def write(path: Path, gaussians: Gaussians, place: Place) -> int:
        similarity = _needed(np.asarray(gaussians.means, np.float64))
        if similarity.is_identity:
            clipped = form.write(path, gaussians, place)
            _beside(path).unlink(missing_ok=True)
            return clipped
        if not similarity.is_possible:
            raise InputError(f"{path}: Gaussians that are so far off have no place in it ({similarity.summary})")
        # Both are written before either has its name: no file of local coordinates is without what tells them.
        with atomic_path(_beside(path)) as beside:
            json_files.write(beside, {"about": _ABOUT, **asdict(similarity)})
            return form.write(path, similarity.gaussians_to_local(gaussians), place)

    return Format(read, write)


def _needed(means: np.ndarray) -> Similarity:
    similarity = of_points(means)
    is_usual = USUAL_SCALES[0] <= similarity.scale <= USUAL_SCALES[1] and not loses_in_float32(means)
    return IDENTITY if is_usual else similarity


def _beside(path: str | Path) -> Path:
    return Path(f"{path}.similarity.json")


FORMATS = {
    ".compressed.ply": _local(Format(compressed_ply.read_compressed_ply, compressed_ply.write_compressed_ply)),
    ".ply": Format(ply.read_gaussians, ply.write_gaussians),
    ".sog": _local(Format(sog.read_sog, _stated_beside(sog.write_sog))),
    ".spz": _local(Format(spz.read_spz, _stated_beside(spz.write_spz))),
}


def format_of(path: str | Path) -> Format:
    """The format of a file's suffix, in capitals or not; the longest that fits, or InputError where none does."""
    for suffix, form in FORMATS.items():
        if Path(path).name.lower().endswith(suffix):
            return form
    raise InputError(f"{path}: files of Gaussians end in {', '.join(FORMATS)}")


def load_gaussians(path: str | Path) -> Gaussians:
    """The Gaussians of a file (`.ply`, `.compressed.ply`, `.sog`, `.spz`), or of a run folder, as numpy arrays.

    They are where the file has them, the means in float64 where float32 would lose that place. `gsjax.Scene.similarity`
    converts them to the coordinates of a loaded scene (`gaussians_to_local`).

    Raises:
        InputError: There is no such file, its suffix is not known, it is damaged, or a folder holds no finished run.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.is_dir():
        finish_replacement(path)
        if not (path / "gaussians.ply").exists():
            hint = "its training has not finished" if (path / "manifest.json").exists() else "it is no run folder"
            raise InputError(f"{path}: holds no gaussians.ply; {hint}")
        path = path / "gaussians.ply"
    return format_of(path).read(path)


def save_gaussians(gaussians: Gaussians, path: str | Path, place: Place = UNPLACED) -> int:
    """Writes a file of the kind that the suffix says (`.ply`, `.compressed.ply`, `.sog`, `.spz`).

    Args:
        gaussians: What to write; free rows of a buffer, as training has them, are left out.
        path: Where.
        place: What is known of the world that they are in: stated by a comment of a PLY, and else in a second file.

    Returns:
        How many Gaussians hold values that the format cannot reach, and were clipped to it; none in a `.ply`.

    Raises:
        InputError: The suffix is not known, the format cannot hold these Gaussians, or the file cannot be written.
    """
    alive = np.asarray(is_alive(gaussians))
    living = gaussians if alive.all() else take(gaussians, alive)
    return format_of(path).write(Path(path), living, place)
