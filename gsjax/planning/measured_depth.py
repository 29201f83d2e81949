"""Measured depth in a scene's own units: what one metre is there, by the points of structure from motion."""

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from gsjax.errors import InputError
from gsjax.io.depth_maps import DepthMaps, Readings, open_depth_maps
from gsjax.io.messages import print_once
from gsjax.scene import Frame, Scene
from gsjax.settings import Supervision

FEWEST = 100  # points from which the scale is told
WIDEST = 0.2  # median of |log(point / measured)| from which maps and points do not show one thing
TRUSTED = 127  # confidence of what the scale is told by, of 255
ALIKE = 0.02  # of 1: the scene is in metres already

Depths = Callable[[int], Iterable[Readings]]
"""How many times smaller photos are -> depth in scene units and confidence of each, see `Batch`."""


class MeasuredDepth(NamedTuple):
    """What the training photos' depth maps say."""

    depths: Depths
    line: str  # what was found


class _Ratios(NamedTuple):
    """Of points to what was measured where they are seen, both in the units that they come in."""

    values: np.ndarray

    @property
    def middle(self) -> float:
        return float(np.median(self.values))

    @property
    def spread(self) -> float:
        return float(np.median(np.abs(np.log(self.values / self.middle))))


def measured_depth(scene: Scene, supervision: Supervision) -> MeasuredDepth | None:
    """The depth maps of the training photos, in scene units; None where the settings name none.

    Raises:
        InputError: The folder, its unit or a map cannot be used, or the maps do not fit the scene's points.
    """
    frames = scene.train_frames
    if supervision.depth is None:
        if listed := sum(frame.depth is not None for frame in frames):
            print_once(f"{scene.root}: lists depth maps of {listed} of {len(frames)} photos; --depth trains on them")
        return None
    maps = open_depth_maps(scene.root, supervision.depth, supervision.depth_unit, frames)
    factor, scale_note = _factor(scene, maps)

    def depths(scale: int) -> Iterator[Readings]:
        return (_of_frame(maps, frame, factor, scale) for frame in frames)

    notes = "; ".join(note for note in (scale_note, maps.note) if note)
    return MeasuredDepth(depths, f"of {len(maps.read)} of {len(frames)} photos, in {maps.unit}; {notes}")


def _of_frame(maps: DepthMaps, frame: Frame, factor: float, scale: int) -> Readings:
    if frame.name not in maps.read:
        nothing = np.zeros((frame.height // scale, frame.width // scale), np.float32)
        return nothing, nothing.astype(np.uint8)
    depth, trust = maps.at(frame, scale)
    return depth * np.float32(factor), trust


def _factor(scene: Scene, maps: DepthMaps) -> tuple[float, str]:
    """Scene units of one unit of the maps, and how that was found."""
    own = float(scene.similarity.length_to_local(1.0))
    ratios = _ratios(scene, maps)
    if len(ratios.values) >= FEWEST and ratios.spread > WIDEST:
        raise InputError(
            f"{maps.folder}: its depth and the points of the scene differ by {100 * ratios.spread:.0f} % at any scale;"
            " are the maps of these photos, and is it depth along the camera's axis?"
        )
    metres = maps.metres
    if metres is None:
        return own * scene.place.scale, "taken as it is"
    if len(ratios.values) < FEWEST:
        return own * metres, "no points tell the scale of the scene, which is taken to be in metres"
    scale = ratios.middle / (own * metres)  # units of the world to a metre
    agreement = f"{len(ratios.values):,} points differ from it by {100 * ratios.spread:.1f} %"
    if abs(scale - 1) < ALIKE:
        return own * metres, f"the scene is in metres: {agreement}"
    return ratios.middle, f"1 m is {scale:.4g} units of the scene: {agreement}"


def _ratios(scene: Scene, maps: DepthMaps) -> _Ratios:
    """Points by what was measured at the pixels where structure from motion saw them."""
    if scene.tracks is None:
        return _Ratios(np.empty(0))
    tracks = scene.tracks()
    numbers = {name: number for number, name in enumerate(tracks.names)}
    ratios = []
    for frame in scene.train_frames:
        if frame.name not in maps.read or frame.name not in numbers:
            continue
        in_photo = tracks.photo == numbers[frame.name]
        z = scene.points[tracks.point[in_photo]] @ frame.viewmat[2, :3] + frame.viewmat[2, 3]
        xy = tracks.rays[in_photo] * frame.K[[0, 1], [0, 1]] + frame.K[:2, 2]
        depth, trust = maps.at(frame, 1)
        within = ((xy >= 0) & (xy < (frame.width, frame.height))).all(axis=-1) & (z > 0)
        column, row = np.where(within[:, None], xy, 0).astype(int).T
        measured = np.where(within & (trust[row, column] > TRUSTED), depth[row, column], 0)
        ratios.append(z[measured > 0] / measured[measured > 0])
    return _Ratios(np.concatenate(ratios) if ratios else np.empty(0))
