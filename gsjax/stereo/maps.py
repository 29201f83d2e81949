"""Stereo depth and normals of photos by name, which a run stores in one file; and what they say of another map."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from gsjax.errors import InputError
from gsjax.io.arrays import read_arrays
from gsjax.io.files import atomic_path
from gsjax.io.images import cv2
from gsjax.scene.batches import NORMAL_UNIT
from gsjax.scene.meshes import unit_or_zero
from gsjax.stereo.depths import PhotoDepths
from gsjax.stereo.planes import photo_segments

FILE = "stereo.npz"  # in the folder of a run
SAME, OTHER = 15.0, 25.0  # degrees: up to one, stereo confirms a normal; from the other on, it contradicts it
FEWEST, LEAST_SHARE = 30, 0.1  # pixels of a segment with both normals, below which nothing is known of the segment
NEAR = 0.04  # of the longer side: deviation of the window around a pixel
DOUBTFUL, SURE = 0.5, 0.8  # share of the pixels that stereo confirms: weight 0 up to one, 1 from the other on


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
        each.view.name: StereoMap(each.depth.astype(np.float32), np.rint(NORMAL_UNIT * each.normals).astype(np.int8))
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
    for name, (depth, normals) in maps.items():
        types = depth.dtype == np.float32 and normals.dtype == np.int8
        shapes = depth.ndim == 2 and depth.size > 0 and normals.shape == (*depth.shape, 3)
        if not (types and shapes and np.all(np.isfinite(depth) & (depth >= 0))):
            raise InputError(f"{run / FILE}: damaged, {name} has no depth and normals of one size")
    return maps


def witnessed_normals(normals: np.ndarray, stereo: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Return stereo normals where they are known; elsewhere those of a map, where stereo confirms them nearby.

    Nearby is both the segment of the photo and a window around the pixel: the worse of both decides
    (experiments/results/room_stages.md).

    Args:
        normals: `[H, W, 3]` int8, 127 times the unit normal of the map, camera's frame; 0 where it has none.
        stereo: `[h, w, 3]` int8, the same of stereo.
        color: `[H, W, 3]` uint8, the photo.

    Returns:
        `[H, W, 3]` int8, 127 times the unit normal, times its weight.
    """
    height, width = normals.shape[:2]
    size = stereo.shape[1::-1]
    small = cv2.resize(normals, size, interpolation=cv2.INTER_NEAREST)
    weight = _confirmed_share(small, stereo, photo_segments(cv2.resize(color, size, interpolation=cv2.INTER_AREA)))
    weight = cv2.resize(np.clip((weight - DOUBTFUL) / (SURE - DOUBTFUL), 0, 1), (width, height))
    stereo_normals = cv2.resize(stereo, (width, height), interpolation=cv2.INTER_NEAREST)
    weighted = np.rint(normals * weight[..., None]).astype(np.int8)
    return np.where(np.any(stereo_normals, axis=-1, keepdims=True), stereo_normals, weighted)


def _confirmed_share(normals: np.ndarray, stereo: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return `[h, w]` float32: the share of the pixels nearby whose normals stereo confirms; 0 where none is known."""
    both = np.any(normals, axis=-1) & np.any(stereo, axis=-1)
    cosine = np.sum(unit_or_zero(normals.astype(np.float32)) * unit_or_zero(stereo.astype(np.float32)), axis=-1)
    apart = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    confirmed = np.where(both, np.clip((OTHER - apart) / (OTHER - SAME), 0, 1), 0)
    count = np.bincount(labels.ravel())
    num_known = np.bincount(labels[both], minlength=len(count))
    is_known = (num_known >= FEWEST) & (num_known >= LEAST_SHARE * count)
    of_segment = np.bincount(labels[both], confirmed[both], minlength=len(count)) / np.maximum(num_known, 1)
    window = NEAR * max(labels.shape)
    around = ndimage.gaussian_filter(both.astype(np.float64), window)
    of_window = ndimage.gaussian_filter(confirmed, window) / np.maximum(around, 1e-3)
    return np.minimum(np.where(is_known, of_segment, 0)[labels], of_window).astype(np.float32)
