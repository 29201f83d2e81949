"""The photos of a run by name: which it trains on and which it holds out, whatever becomes of its data set later."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gsjax.effects.kinds import effect_kinds
from gsjax.errors import InputError
from gsjax.io.messages import first_names, print_once
from gsjax.scene import Frame, Scene

SHAPE = {"train": [str], "held_out": [str]}

Split = Mapping[str, bool]
"""A photo's name -> whether it is held out."""


def split_of(frames: Iterable[Frame]) -> Split:
    """The split of loaded frames."""
    return {frame.name: frame.held_out for frame in frames}


def split_record(split: Split) -> dict[str, list[str]]:
    """A split as the manifest stores it."""
    return {
        "train": [name for name, is_held_out in split.items() if not is_held_out],
        "held_out": [name for name, is_held_out in split.items() if is_held_out],
    }


def parse_split(record: Mapping[str, Any]) -> Split:
    """The split of a record of the manifest."""
    return dict.fromkeys(record["train"], False) | dict.fromkeys(record["held_out"], True)


def with_split(scene: Scene, split: Split, *, run: Path) -> Scene:
    """The scene with the photos of a run and its split.

    A line on stderr names photos of the run that the scene lacks, and another one photos that were added since.

    Raises:
        InputError: The scene has no photo of the run.
    """
    frames = tuple(replace(frame, held_out=split[frame.name]) for frame in scene.frames if frame.name in split)
    if not frames:
        raise InputError(f"{scene.root}: has none of the {len(split)} photos of {run}, such as {next(iter(split))}")
    if absent := missing_photos(frames, split):
        print_once(f"{scene.root}: lacks photos that {run} was begun with: {first_names(absent)}")
    if added := [frame.name for frame in scene.frames if frame.name not in split]:
        print_once(f"{scene.root}: has photos that {run} was begun without, which are left out: {first_names(added)}")
    return replace(scene, frames=frames)


def missing_photos(frames: Iterable[Frame], split: Split) -> list[str]:
    """Names of the photos of a run that are not among the frames."""
    present = {frame.name for frame in frames}
    return [name for name in split if name not in present]


def require_photos_of_effects(scene: Scene, split: Split, manifest: Mapping[str, Any], *, run: Path) -> None:
    """InputError where the scene lacks a photo of which the run's checkpoint has a row, of an effect `per_photo`."""
    per_photo = [name for name, kind in effect_kinds().items() if kind.per_photo]
    simulated = [name for name in manifest.get("effects", {}).get("simulated", ()) if name in per_photo]
    absent = [name for name in missing_photos(scene.frames, split) if not split[name]]
    if simulated and absent:
        raise InputError(
            f"{scene.root}: lacks {first_names(absent)}, which {run} was trained on with {' and '.join(simulated)} of"
            " each photo; put it back to resume"
        )
