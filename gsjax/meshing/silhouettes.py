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
from gsjax.scene.cameras import Camera, thinned_K
from gsjax.scene.meshes import Mesh

MOST_PHOTOS, MOST_PIXELS = 24, 1 << 18  # of each photo: rays at all of them take a second or two a mesh
IS_OBJECT = 127  # of 255: a pixel's coverage above which it is the object's


class Silhouette(NamedTuple):
    """The matte of one photo, at evenly spaced pixels of it."""

    camera: Camera  # of these pixels
    is_object: np.ndarray  # [H, W] bool
    usable: np.ndarray  # [H, W] bool, False where a mask hides the photo


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
        is_object = matte[grid] > IS_OBJECT
        usable = np.ones_like(is_object) if valid is None else valid[grid] > 127
        camera = Camera(frame.viewmat, thinned_K(frame.K, every), *is_object.shape[::-1])
        silhouettes.append(Silhouette(camera, is_object, usable))
    return tuple(silhouettes)


def overlap(mesh: Mesh, silhouettes: Sequence[Silhouette]) -> dict[str, float]:
    """How the silhouettes of a mesh, in the scene's coordinates, cover those of the object, one at least.

    Returns:
        Shares of the pixels that the object or the mesh covers, which add up to 1: `both`, `mesh_alone` and
        `object_alone`.
    """
    cast, counts = ray_caster(mesh), np.zeros(3, np.int64)
    for camera, is_object, usable in silhouettes:
        is_covered = depth_of_mesh(cast, camera) > 0
        parts = is_covered & is_object, is_covered & ~is_object, is_object & ~is_covered
        counts += [np.sum(part & usable) for part in parts]
    return dict(zip(("both", "mesh_alone", "object_alone"), counts / max(counts.sum(), 1), strict=True))
