"""Photos as a training step reads them, with the maps of normals that a network made."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsjax.io.normal_maps import normal_maps
from gsjax.normals.axes import apply_axes, axis_signs
from gsjax.scene import Frame, batches
from gsjax.scene.batches import NORMAL_UNIT, Batch


def read_views(
    frames: Sequence[Frame], *, normals: str | Path | None = None, normal_axes: str = "opencv", scale: int = 1
) -> list[Batch]:
    """Read photos for `train_step`.

    Args:
        frames: Of a scene: `Scene.train_frames`.
        normals: A folder of normal maps, as `gsjax normals` and other programs write them. None: no maps.
        normal_axes: Axes of the maps, see `gsjax.normals.axes.axis_signs`.
        scale: Reduce the photos by this factor.

    Returns:
        One record a photo, alike in size: smaller photos are padded at the right and the bottom.

    Raises:
        InputError: A photo or a map cannot be read.
    """
    views = batches.read_batches(frames, scale=scale)
    if normals is not None:
        signs, read = axis_signs(normal_axes), normal_maps(normals, tuple(frames))
        maps = (apply_axes(read[frame.name](), signs) for frame in frames)
        views = batches.with_normals(views, (np.rint(NORMAL_UNIT * each).astype(np.int8) for each in maps), scale)
    return list(views.views)
