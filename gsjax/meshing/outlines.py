"""What the mattes of photos say of a mesh: the outline of an object is seen, whatever its colours are.

A mesh that is too fat reaches beyond the mattes, one that has lost a rod leaves it bare. Hollows do not show in them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gsjax.mesh import Mesh
from gsjax.meshing.pictures import depth_of_mesh
from gsjax.meshing.rays import ray_caster
from gsjax.scene import Frame, Scene, valid_pixels

MOST_PHOTOS = 24  # They take a second for a mesh of a million triangles.
IS_OBJECT = 127  # of 255: a pixel's coverage above which it is the object's


class Overlap(NamedTuple):
    """Shares of the pixels that the object or the mesh covers, which add up to 1."""

    both: float
    mesh_alone: float
    object_alone: float


def frames_with_mattes(scene: Scene) -> tuple[Frame, ...]:
    """Photos with a matte, at most `MOST_PHOTOS` of them and evenly chosen; none where there is one without.

    Held-out photos count too: nothing was trained on their pixels.

    Args:
        scene: A loaded data set.

    Raises:
        InputError: A photo cannot be read.
    """
    count = min(len(scene.frames), MOST_PHOTOS)
    chosen = [scene.frames[index] for index in np.linspace(0, len(scene.frames) - 1, count).astype(int)]
    return tuple(chosen) if all(frame.pixels().matte is not None for frame in chosen) else ()


def overlap(mesh: Mesh, frames: Sequence[Frame]) -> Overlap:
    """How the outlines of a mesh cover those of the object, over all valid pixels of the frames.

    Args:
        mesh: The surface, in the frames' coordinates.
        frames: Of which each has a matte, and one at least shows something.
    """
    cast, counts = ray_caster(mesh), np.zeros(3, np.int64)
    for frame in frames:
        shown = depth_of_mesh(mesh, frame.viewmat, frame.K, frame.width, frame.height, cast=cast) > 0
        matte, valid = frame.pixels().matte, valid_pixels(frame)
        assert matte is not None
        is_object, usable = matte > IS_OBJECT, True if valid is None else valid
        counts += [np.sum(part & usable) for part in (shown & is_object, shown & ~is_object, is_object & ~shown)]
    return Overlap(*(counts / max(counts.sum(), 1)))
