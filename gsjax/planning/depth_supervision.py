"""What supervises depth: measured maps in the scene's own units, or multi-view stereo, which has normals as well."""

from collections.abc import Callable, Container, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsjax.errors import InputError
from gsjax.io.depth_maps import DepthMaps, Readings, open_depth_maps
from gsjax.io.messages import print_once
from gsjax.scene import Frame, Scene
from gsjax.settings import Supervision
from gsjax.stereo import PhotoDepths, StereoMaps, depths_of_photos, read_stereo_maps, stereo_maps
from gsjax.training.loop import Depths

FEWEST = 100  # points that an estimate of the scale takes
WIDEST = 0.2  # median of |log(point / measured)|, above which maps and points contradict each other
TRUSTED = 127  # confidence, of 255, above which depth counts for the scale
ALIKE = 0.02  # difference of the scale from 1 up to which the scene is in metres
MOST_PHOTOS = 100  # evenly spread; of more photos some have no stereo depth
CERTAIN = 255  # confidence of depth that other photos confirm


class MeasuredDepth(NamedTuple):
    """What the training photos' depth maps say."""

    depths: Depths
    line: str  # what was found


def measured_depth(scene: Scene, supervision: Supervision) -> MeasuredDepth | None:
    """The depth maps of the training photos, in scene units; None where the settings name none.

    Raises:
        InputError: The folder, its unit or a map cannot be used, or the maps do not fit the scene's points.
    """
    frames = scene.train_frames
    if supervision.depth is None:
        if listed := sum(frame.depth is not None for frame in frames):
            print_once(f"{scene.root}: lists depth maps of {listed} of {len(frames)} photos; see supervision.depth")
        return None
    maps = open_depth_maps(scene.root, supervision.depth, supervision.depth_unit, frames)
    factor, scale_note = _factor(scene, maps)

    def reading(frame: Frame, scale: int) -> Readings:
        depth, trust = maps.at(frame, scale)
        return depth * np.float32(factor), trust

    notes = "; ".join(note for note in (scale_note, maps.note) if note)
    depths = _depths(frames, maps.read, reading)
    return MeasuredDepth(depths, f"of {len(maps.read)} of {len(frames)} photos, in {maps.unit}; {notes}")


def _depths(frames: Sequence[Frame], names: Container[str], reading: Callable[[Frame, int], Readings]) -> Depths:
    """The depth of frames; nothing of those that are not named."""

    def read(frame: Frame, scale: int) -> Readings:
        size = frame.height // scale, frame.width // scale
        return reading(frame, scale) if frame.name in names else (np.zeros(size, np.float32), np.zeros(size, np.uint8))

    return lambda scale: (read(frame, scale) for frame in frames)


def _factor(scene: Scene, maps: DepthMaps) -> tuple[float, str]:
    """Scene units of one unit of the maps, and how that was found."""
    own = float(scene.similarity.length_to_local(1.0))
    ratios, metres = _ratios(scene, maps), maps.metres
    middle = float(np.median(ratios)) if len(ratios) >= FEWEST else 1.0
    spread = float(np.median(np.abs(np.log(ratios / middle)))) if len(ratios) >= FEWEST else 0.0
    if spread > WIDEST:
        raise InputError(
            f"{maps.folder}: its depth and the points of the scene differ by {100 * spread:.0f} % at any scale;"
            " are the maps of these photos, and is it depth along the camera's axis?"
        )
    if metres is None:
        return own * scene.place.scale, "taken as it is"
    if len(ratios) < FEWEST:
        return own * metres, "no points determine the scale of the scene, which is taken to be in metres"
    scale = middle / (own * metres)  # units of the world to a metre
    agreement = f"{len(ratios):,} points differ from it by {100 * spread:.1f} %"
    if abs(scale - 1) < ALIKE:
        return own * metres, f"the scene is in metres: {agreement}"
    return middle, f"1 m is {scale:.4g} units of the scene: {agreement}"


def _ratios(scene: Scene, maps: DepthMaps) -> np.ndarray:
    """Depths of points by what was measured where structure from motion saw them, both in their own units."""
    if scene.tracks is None:
        return np.empty(0)
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
    return np.concatenate(ratios) if ratios else np.empty(0)


class StereoSupervision(NamedTuple):
    """Maps by the photo's name, of which there may be none."""

    maps: StereoMaps
    swept: PhotoDepths | None = None  # None: the maps are those of an earlier run
    line: str | None = None  # how many photos have depth

    @property
    def fault(self) -> str | None:
        """Why there is no stereo although the settings request it; None: there is, or they do not."""
        return self.swept and self.swept.fault and f"no multi-view stereo: {self.swept.fault}"

    @property
    def normals(self) -> dict[str, np.ndarray]:
        """Normals by the photo's name."""
        return {name: each.normals for name, each in self.maps.items()}

    def depths(self, frames: tuple[Frame, ...]) -> Depths | None:
        """The depth of frames; None where no photo has any."""
        return _depths(frames, self.maps, self._reading) if self.maps else None

    def _reading(self, frame: Frame, scale: int) -> Readings:
        depth = self.maps[frame.name].depth_at_size(frame.width // scale, frame.height // scale)
        return depth, np.where(depth > 0, CERTAIN, 0).astype(np.uint8)


def stereo_supervision(
    scene: Scene, supervision: Supervision, run: Path | None, *, vanilla: bool = False
) -> StereoSupervision:
    """Compute the stereo maps of the training photos, where the settings request them; a resumed `run` has its own.

    Vanilla 3DGS has none.

    Raises:
        InputError: The tracks or the maps of the run cannot be read.
    """
    is_complete = supervision.normals is not None and supervision.depth is not None
    if not supervision.stereo_weight or vanilla or is_complete:
        return StereoSupervision({})
    swept = None if run is not None else depths_of_photos(scene, MOST_PHOTOS)
    maps = stereo_maps(swept) if swept is not None else read_stereo_maps(run) or {}
    what = "depth and normals" if supervision.normals is None else "depth"
    return StereoSupervision(maps, swept, swept and f"multi-view stereo supervises {what}: {swept.line}")
