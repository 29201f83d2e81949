"""What a command may write to: never what it reads."""

import os
from pathlib import Path

from gsjax.errors import InputError
from gsjax.runs import is_run
from gsjax.runs.run import Run

OF_RUN = {
    "config.json", "plan.json", "manifest.json", "place.json", "metrics.jsonl", "pictures", "report.html",
    "report.json", "checkpoints", "gaussians.ply", "cameras.json", "effects.json", "poses.json", "background.json",
    "masks", "normals",
}  # fmt: skip
OF_REFINEMENT = {"mesh.ply", "mesh.glb"}
OF_DATA_SET = {".bin", ".txt", ".npz", ".npy", ".ply"}  # suffixes, and transforms*.json


def require_apart(out: str | Path, *inputs: str | Path | None) -> None:
    """Refuses an output that is an input, or a part of one, with an InputError that names both.

    Inputs are files; run folders, which include the run's files and its data set, but no mesh that was made of it; and
    data sets, which include every file that a reader may read. None: not given.
    """
    place = Path(os.path.realpath(out))
    for source in inputs:
        if source is not None and any(_is_part(place, read) for read in _read(Path(os.path.realpath(source)))):
            raise InputError(f"{out}: is what is read from {source}; choose another place for the output")


def _read(source: Path) -> list[Path]:
    """An input, and of a run its data set too."""
    return [source, Path(os.path.realpath(Run(source).manifest["scene"]))] if is_run(source) else [source]


def _is_part(out: Path, source: Path) -> bool:
    if out == source or (out.is_file() and source.is_file() and out.samefile(source)):
        return True
    if not source.is_dir() or not out.is_relative_to(source):
        return False
    first, *inner = out.relative_to(source).parts
    if is_run(source):
        return first in (OF_RUN | OF_REFINEMENT if Run(source).is_refinement else OF_RUN)
    is_read = first.startswith("transforms") or out.suffix.lower() in OF_DATA_SET
    return out.is_file() and (bool(inner) or is_read)
