"""What multi-view stereo of the photos supervises in a run: depth, and normals where no maps are given."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsjax.io.depth_maps import Readings
from gsjax.scene import Frame, Scene
from gsjax.settings import Settings
from gsjax.stereo import PhotoDepths, StereoMaps, depths_of_photos, read_stereo_maps, stereo_maps
from gsjax.training.loop import Depths

MOST_PHOTOS = 100  # evenly spread; of more photos some have no stereo depth
CERTAIN = 255  # confidence of depth that other photos confirm


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
        if not self.maps:
            return None
        return lambda scale: (self._reading(frame, scale) for frame in frames)

    def _reading(self, frame: Frame, scale: int) -> Readings:
        width, height = frame.width // scale, frame.height // scale
        if frame.name not in self.maps:
            return np.zeros((height, width), np.float32), np.zeros((height, width), np.uint8)
        depth = self.maps[frame.name].depth_at_size(width, height)
        return depth, np.where(depth > 0, CERTAIN, 0).astype(np.uint8)


def stereo_supervision(scene: Scene, settings: Settings, run: Path | None) -> StereoSupervision:
    """Compute the stereo maps of the training photos, where the settings request them; a resumed `run` has its own.

    Raises:
        InputError: The tracks or the maps of the run cannot be read.
    """
    supervision = settings.supervision
    is_complete = supervision.normals is not None and supervision.depth is not None
    if not supervision.stereo_weight or settings.schedule.vanilla or is_complete:
        return StereoSupervision({})
    swept = None if run is not None else depths_of_photos(scene, MOST_PHOTOS)
    maps = stereo_maps(swept) if swept is not None else read_stereo_maps(run) or {}
    what = "depth and normals" if supervision.normals is None else "depth"
    return StereoSupervision(maps, swept, swept and f"multi-view stereo supervises {what}: {swept.line}")
