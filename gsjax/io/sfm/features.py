"""SIFT features of photos, and their matches.

OpenCV finds the features and products of matrices match them: on a CPU without its vector units COLMAP's own build
takes seconds for a pair of photos, this a tenth of one.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from gsjax.io.images import cv2, resize
from gsjax.io.sfm.shots import Shot

_MOST_FEATURES = 4096  # a photo
_CONTRAST = 0.012  # low: small and blurred photos have few strong corners
_MOST_READERS = 4  # threads that hold a photo's pyramid, about 400 MB at 1600 pixels
_LARGEST_ANGLE = 0.7  # radians between descriptors that match
_LARGEST_RATIO = 0.8  # of that angle to the one of the second best
_BAND = 4.0  # pixels to either side of an epipolar line
_BLOCK = 1024  # features at a time against all of another photo: the table of products stays small


@dataclass(frozen=True)
class Features:
    """What is told apart in a photo, largest first: large features last longest when the camera moves."""

    xy: np.ndarray  # [N, 2] float64 pixels of the sensor's frame, pixel centres at +0.5
    descriptors: np.ndarray  # [N, 128] uint8, roots of SIFT's histograms (RootSIFT)

    def unit(self, count: int | None = None) -> np.ndarray:
        """`[N, 128]` float32 unit vectors of the largest `count` features, or of all."""
        vectors = self.descriptors[:count].astype(np.float32)
        return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.float32(1))


def find_features(
    shots: list[Shot], max_image_size: int, threads: int, progress: Callable[..., tqdm]
) -> list[Features]:
    """The features of every photo, sought at a longer side of at most `max_image_size` pixels.

    Raises:
        InputError: A photo is damaged; it is named.
    """
    cv2.setNumThreads(1)  # Photos side by side use the cores better than parts of one photo.
    with (
        ThreadPoolExecutor(min(threads, _MOST_READERS)) as pool,
        progress(total=len(shots), desc="features", unit="photo") as bar,
    ):
        found = []
        for features in pool.map(lambda shot: _features(shot.read(), max_image_size), shots):
            found.append(features)
            bar.update(1)
    return found


class Band(NamedTuple):
    """Where matches of each feature of one photo may lie in another: along its epipolar line."""

    lines: np.ndarray  # [N, 3] float32, of unit normal, in pixels of the other photo
    points: np.ndarray  # [M, 3] float32 homogeneous pixels of the other photo's features


def match(a: np.ndarray, b: np.ndarray, within: tuple[Band, Band] | None = None) -> np.ndarray:
    """Rows of two sets of unit vectors that are each other's nearest, and clearly nearer than the second nearest.

    Args:
        a: `[N, 128]` float32.
        b: `[M, 128]` float32.
        within: Where to look: for `a` in b's photo, and for `b` in a's. None: everywhere.

    Returns:
        `[K, 2]` uint32 rows of `a` and `b`.
    """
    if min(len(a), len(b)) < 2:
        return np.empty((0, 2), np.uint32)
    there, back = within or (None, None)
    nearest = _nearest(a, b, there)
    rows = np.flatnonzero(nearest >= 0)
    columns, column = np.unique(nearest[rows], return_inverse=True)
    returned = _nearest(b[columns], a, back and Band(back.lines[columns], back.points))
    return np.stack([rows, nearest[rows]], axis=-1)[returned[column] == rows].astype(np.uint32)


def bands(a: Features, b: Features, fundamental: np.ndarray) -> tuple[Band, Band]:
    """The bands of two photos whose pixels satisfy `b^T F a = 0`, `fundamental` being F, `[3, 3]`."""
    points_a, points_b = (np.c_[one.xy, np.ones(len(one.xy))] for one in (a, b))
    lines_b, lines_a = points_a @ fundamental.T, points_b @ fundamental
    return _band(lines_b, points_b), _band(lines_a, points_a)


def _band(lines: np.ndarray, points: np.ndarray) -> Band:
    lines = lines / np.maximum(np.linalg.norm(lines[:, :2], axis=1, keepdims=True), 1e-12)
    return Band(lines.astype(np.float32), points.astype(np.float32))


def _features(colors: np.ndarray, max_image_size: int) -> Features:
    grey = cv2.cvtColor(colors, cv2.COLOR_RGB2GRAY)
    height, width = grey.shape
    reduced = max(1.0, max(width, height) / max_image_size)
    grey = resize(grey, max(1, round(width / reduced)), max(1, round(height / reduced)))
    sift = cv2.SIFT_create(contrastThreshold=_CONTRAST, enable_precise_upscale=True)
    keypoints = sorted(sift.detect(grey, None), key=lambda keypoint: -keypoint.size)[:_MOST_FEATURES]
    if not keypoints:
        return Features(np.empty((0, 2)), np.empty((0, 128), np.uint8))
    keypoints, histograms = sift.compute(grey, keypoints)
    histograms /= np.maximum(histograms.sum(axis=1, keepdims=True), 1e-6)
    scale = np.array([width / grey.shape[1], height / grey.shape[0]])
    xy = (np.array([keypoint.pt for keypoint in keypoints], np.float64) + 0.5) * scale
    return Features(xy, np.minimum(np.rint(np.sqrt(histograms) * 512), 255).astype(np.uint8))


def _nearest(a: np.ndarray, b: np.ndarray, band: Band | None) -> np.ndarray:
    """`[N]` the row of `b` nearest to each of `a`, or -1 where it is too far off or hardly nearer than the second."""
    nearest = np.empty(len(a), np.int64)
    for start in range(0, len(a), _BLOCK):
        cosines = a[start : start + _BLOCK] @ b.T
        if band is not None:
            cosines[np.abs(band.lines[start : start + _BLOCK] @ band.points.T) > _BAND] = -1
        rows = np.arange(len(cosines))
        best = cosines.argmax(axis=1)
        first = np.arccos(np.clip(cosines[rows, best], -1, 1))
        cosines[rows, best] = -1
        second = np.arccos(np.clip(cosines.max(axis=1), -1, 1))
        is_clear = (first < _LARGEST_ANGLE) & (first < _LARGEST_RATIO * second)
        nearest[start : start + _BLOCK] = np.where(is_clear, best, -1)
    return nearest
