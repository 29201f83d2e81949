"""Normals of a photo whose map is doubtful: those of stereo, and of the map what stereo confirms."""

import numpy as np
from scipy import ndimage

from gsjax.io.images import cv2
from gsjax.scene.meshes import unit_or_zero
from gsjax.stereo.planes import photo_segments

SAME, OTHER = 15.0, 25.0  # degrees: up to one, stereo confirms a normal; from the other on, it contradicts it
FEWEST, LEAST_SHARE = 30, 0.1  # pixels of a segment with both normals, below which nothing is known of the segment
NEAR = 0.04  # of the longer side: deviation of the window around a pixel
DOUBTFUL, SURE = 0.5, 0.8  # share of the pixels that stereo confirms: weight 0 up to one, 1 from the other on


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
