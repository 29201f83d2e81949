"""A run whose data set was moved to another folder."""

from pathlib import Path
from typing import Any

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.locks import lock_folder
from gsjax.io.scenes import load_scene
from gsjax.io.splits import NONE
from gsjax.runs import update_manifest
from gsjax.runs.run import Run


def relocate_scene(folder: str | Path, scene: str | Path) -> None:
    """Record in a run folder that its data set is in another place now.

    Paths inside the data set that its settings and its plan name move with it.

    Raises:
        InputError: It is no run folder, another process is at work in it, or `scene` is no data set or has no photo of
            the run.
    """
    folder, place = Path(folder), str(Path(scene).resolve())
    run = Run.open(folder)
    before = str(run.manifest["scene"])
    frames = load_scene(place, images=relocated_images(run, place), hold_out=NONE).frames
    if run.split and not any(frame.name in run.split for frame in frames):
        raise InputError(f"{place}: has none of the photos of {folder}, such as {next(iter(run.split))}")
    with lock_folder(folder):
        for file in (folder / "config.json", folder / "plan.json"):
            if file.exists():
                json_files.write(file, _relocate(json_files.read(file), before, place))
        update_manifest(folder, scene=place)


def relocated_images(run: Run, scene: str | Path) -> str | None:
    """The folder of photos that a run names, where its data set is in `scene` now."""
    return _relocate(run.settings["photos"].get("images"), str(run.manifest["scene"]), str(Path(scene).resolve()))


def _relocate(value: Any, before: str, now: str) -> Any:
    """JSON in which absolute paths in one folder are paths in another."""
    if isinstance(value, dict):
        return {key: _relocate(each, before, now) for key, each in value.items()}
    if isinstance(value, list):
        return [_relocate(each, before, now) for each in value]
    if isinstance(value, str) and (value == before or value.startswith(f"{before}/")):
        return now + value[len(before) :]
    return value
