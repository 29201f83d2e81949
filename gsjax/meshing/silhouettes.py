"""The silhouettes of an object in the mattes of photos, and how a mesh overlaps them.

A mesh that is too fat reaches beyond the mattes, one that has lost a rod leaves it bare. Hollows do not show in them.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gsjax.meshing.pictures import depth_of_mesh
from gsjax.meshing.ray_queries import ray_caster
from gsjax.scene import Scene
from gsjax.scene.meshes import Mesh

MOST_PHOTOS, MOST_PIXELS = 24, 1 << 18  # of each photo: rays at all of them take a second or two a mesh
IS_OBJECT = 127  # of 255: a pixel's coverage above which it is the object's


class Silhouette(NamedTuple):
    """The matte of one photo, at evenly spaced pixels of it."""

    viewmat: np.ndarray  # [4, 4] world to camera
    K: np.ndarray  # [3, 3] of these pixels
    is_object: np.ndarray  # [H, W] bool
    usable: np.ndarray  # [H, W] bool, False where a mask hides the photo


class Overlap(NamedTuple):
    """Shares of the pixels that the object or the mesh covers, which add up to 1."""

    both: float
    mesh_alone: float
    object_alone: float


def silhouettes_of(scene: Scene) -> tuple[Silhouette, ...]:
    """Those of at most `MOST_PHOTOS` photos, evenly chosen; none where one of them has no matte.

    Held-out photos count too: nothing was trained on their pixels.

    Raises:
        InputError: A photo cannot be read.
    """
    count = min(len(scene.frames), MOST_PHOTOS)
    silhouettes = []
    for index in np.linspace(0, len(scene.frames) - 1, count).astype(int):
        frame = scene.frames[index]
        _, matte, valid = frame.pixels()
        if matte is None:
            return ()
        every = math.ceil(math.sqrt(matte.size / MOST_PIXELS))
        grid = (slice(every // 2, None, every),) * 2
        # The centre of the first pixel that is taken is to be the centre of the first one of the smaller picture.
        K = frame.K.astype(np.float64)
        K[:2, 2] -= every // 2 + 0.5 - every / 2
        K = np.diag([1 / every, 1 / every, 1]) @ K
        usable = np.ones_like(matte[grid], bool) if valid is None else valid[grid] > 127
        silhouettes.append(Silhouette(frame.viewmat, K, matte[grid] > IS_OBJECT, usable))
    return tuple(silhouettes)


def overlap(mesh: Mesh, silhouettes: Sequence[Silhouette]) -> Overlap:
    """How the silhouettes of a mesh, in the scene's coordinates, cover those of the object, one at least."""
    cast, counts = ray_caster(mesh), np.zeros(3, np.int64)
    for viewmat, K, is_object, usable in silhouettes:
        height, width = is_object.shape
        is_covered = depth_of_mesh(cast, viewmat, K, width, height) > 0
        counts += [
            np.sum(part & usable) for part in (is_covered & is_object, is_covered & ~is_object, is_object & ~is_covered)
        ]
    return Overlap(*(counts / max(counts.sum(), 1)))
