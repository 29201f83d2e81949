"""Stereo depth and normals of photos by name, as training and meshes read them; a run stores them in one file."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsjax.errors import InputError
from gsjax.io.arrays import read_arrays
from gsjax.io.files import atomic_path
from gsjax.io.images import cv2
from gsjax.scene.batches import NORMAL_UNIT
from gsjax.stereo.depths import PhotoDepths

FILE = "stereo.npz"  # in the folder of a run


class StereoMap(NamedTuple):
    """Depth and normals of one photo, of `gsjax.stereo.views.SIDE` at the most."""

    depth: np.ndarray  # [h, w] float32 camera z, scene units; 0 where it is unknown
    normals: np.ndarray  # [h, w, 3] int8, `NORMAL_UNIT` times the unit normal, camera's frame, towards it; 0 the same

    def depth_at_size(self, width: int, height: int) -> np.ndarray:
        """Return the depth at another size; every pixel takes the nearest one."""
        return cv2.resize(self.depth, (width, height), interpolation=cv2.INTER_NEAREST)


StereoMaps = Mapping[str, StereoMap]
"""By the photo's name; a photo without stereo depth is absent."""


def stereo_maps(depths: PhotoDepths) -> dict[str, StereoMap]:
    """Return the maps of the photos with depth."""
    return {
        each.view.name: StereoMap(
            np.where(each.depth.is_confident, each.depth.z, 0).astype(np.float32),
            np.rint(NORMAL_UNIT * each.normals).astype(np.int8),
        )
        for each in depths.accepted
    }


def write_stereo_maps(run: Path, maps: StereoMaps) -> None:
    """Write the maps to a run."""
    arrays = {f"{name}/{field}": array for name, each in maps.items() for field, array in each._asdict().items()}
    with atomic_path(run / FILE) as temporary:
        np.savez_compressed(temporary, **arrays)


def read_stereo_maps(run: Path) -> dict[str, StereoMap] | None:
    """Return the maps of a run; None where it has none.

    Raises:
        InputError: The file is damaged.
    """
    if not (run / FILE).is_file():
        return None
    arrays = read_arrays(run / FILE)
    names = dict.fromkeys(key.rpartition("/")[0] for key in arrays)
    try:
        maps = {name: StereoMap(*(arrays[f"{name}/{field}"] for field in StereoMap._fields)) for name in names}
    except KeyError as fault:
        raise InputError(f"{run / FILE}: has no {fault.args[0]}") from None
    for name, each in maps.items():
        if not _is_map(each):
            raise InputError(f"{run / FILE}: damaged, {name} has no depth and normals of one size")
    return maps


def _is_map(stereo_map: StereoMap) -> bool:
    depth, normals = stereo_map
    types = depth.dtype == np.float32 and normals.dtype == np.int8
    return types and depth.ndim == 2 and depth.size > 0 and normals.shape == (*depth.shape, 3) and _is_depth(depth)


def _is_depth(depth: np.ndarray) -> bool:
    return bool(np.all(np.isfinite(depth) & (depth >= 0)))
