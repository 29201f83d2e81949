"""Estimates of exposure, fall-off, camera moves and background, as files of the run folder."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np

from gsjax.effects.appearance import Appearance, as_near_photos
from gsjax.effects.poses import Move
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.runs import read_similarity
from gsjax.scene import Frame
from gsjax.scene.similarity import Similarity

FILE, POSES, BACKGROUND = "effects.json", "poses.json", "background.json"
SHAPES = {
    Appearance: {"log_gains": [float, 3], "falloff": [float, 2]},
    Move: {"turn": [float, 3], "shift": [float, 3], "focal": float},
}
COUNTS = [(degree + 1) ** 2 for degree in range(5)]
T = TypeVar("T", Appearance, Move)
_ABOUT = "cameras.json has the cameras after these moves of those of the data set: radians, scene units, a factor"
_BEHIND = "behind all Gaussians: max(0, SH(direction of the ray in the world) + 0.5), as Gaussians' colours are"


class PhotoEffects(NamedTuple):
    """Estimates of the simulated effects, of each photo by name. What a run does not simulate is empty."""

    appearances: Mapping[str, Appearance] = MappingProxyType({})
    moves: Mapping[str, Move] = MappingProxyType({})  # of its camera from where the data set has it
    background: np.ndarray | None = None  # [(L + 1)^2, 3] SH coefficients, see `gsjax.rendering.backdrop`
    near_appearances: Mapping[str, Appearance] = MappingProxyType({})  # of held-out photos, as of those near them

    def with_near_appearances(self, frames: Sequence[Frame]) -> "PhotoEffects":
        """Add appearances of the held-out photos, from the photos taken near them, where there are appearances."""
        return self._replace(near_appearances=as_near_photos(frames, self.appearances)) if self.appearances else self


def with_moved_cameras(frames: tuple[Frame, ...], moves: Mapping[str, Move]) -> tuple[Frame, ...]:
    """The frames with their cameras where training moved them; as they are without moves."""
    return tuple(moves[frame.name].apply(frame) if frame.name in moves else frame for frame in frames)


def write_photo_effects(run: Path, effects: PhotoEffects) -> None:
    """`effects.json`, `poses.json` and `background.json`, those of estimates that there are."""
    if effects.appearances:
        json_files.write(run / FILE, {"photos": {name: look._asdict() for name, look in effects.appearances.items()}})
    if effects.moves:
        moves = _in_units(effects.moves, read_similarity(run).length_to_world)
        photos = {name: move._asdict() for name, move in moves.items()}
        json_files.write(run / POSES, {"about": _ABOUT, "photos": photos})
    if effects.background is not None:
        json_files.write(run / BACKGROUND, {"about": _BEHIND, "sh": effects.background})


def read_photo_effects(run: Path) -> PhotoEffects:
    """Read the estimates of a run, empty where it simulated nothing; InputError of a damaged file."""
    file = run / BACKGROUND
    background = np.asarray(json_files.read(file, {"sh": [[float, 3]]})["sh"], np.float32) if file.exists() else None
    if background is not None and len(background) not in COUNTS:
        raise InputError(f"{file}: sh has {len(background)} rows, degrees 0-4 have one of {COUNTS}")
    moves = _in_units(_read(run / POSES, Move), read_similarity(run).length_to_local)
    return PhotoEffects(_read(run / FILE, Appearance), moves, background)


def moves_line(moves: Mapping[str, Move], similarity: Similarity) -> str:
    """How far cameras went, in words; `similarity` is to their coordinates from those of the data set."""
    moves = _in_units(moves, similarity.length_to_world)
    turns, shifts = (np.linalg.norm([getattr(m, name) for m in moves.values()], axis=1) for name in ("turn", "shift"))
    turns, shifts = (each[each > 0] if each.any() else each for each in (np.degrees(turns), shifts))  # not held out
    focals = [move.focal for move in moves.values()]
    return (
        f"cameras turned by {np.median(turns):.3f} degrees and shifted by {np.median(shifts):.3g} scene units"
        f" (medians), focal lengths x{min(focals):.4f} to x{max(focals):.4f}"
    )


def _in_units(moves: Mapping[str, Move], length: Callable[[float], float]) -> dict[str, Move]:
    """The moves with their shifts in other units."""
    return {name: move._replace(shift=tuple(map(length, move.shift))) for name, move in moves.items()}


def _read(file: Path, kind: type[T]) -> dict[str, T]:
    """Records of every photo by name; none where the file is absent."""
    if not file.exists():
        return {}
    photos = json_files.read(file, {"photos": {str: SHAPES[kind]}})["photos"]
    return {name: kind(*(_plain(record[field]) for field in kind._fields)) for name, record in photos.items()}  # pyright: ignore[reportAttributeAccessIssue]


def _plain(value: Any) -> Any:
    return tuple(map(float, value)) if isinstance(value, list) else float(value)
