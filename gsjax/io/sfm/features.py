"""SIFT features of photos, and matches of the nearest descriptors.

OpenCV detects the features, and products of matrices match them: a tenth of a second a pair on a CPU. COLMAP's own
build takes seconds, as it does not use the CPU's vector units.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from gsjax.io.images import cv2, resize
from gsjax.io.parallel_map import Progress, map_with_bar
from gsjax.io.sfm.source_photos import SourcePhoto

MOST_FEATURES = 4096  # a photo
LONGEST_SIDE = 1600  # of a photo in which features are detected, pixels
_CONTRAST = 0.012  # low: small and blurred photos have few strong corners
_MOST_READERS = 4  # threads that hold a photo's pyramid, about 400 MB at 1600 pixels
_ALIKE = 1 - 2e-6  # cosine from which float32 does not tell two descriptors apart; how it errs differs by processor
_MOST_OFF = 4.0  # pixels from where the geometry of two photos puts a feature
_BLOCK = 1024  # features at a time against all of another photo: the table of products stays small


class Nearness(NamedTuple):
    """How near two descriptors must be to match."""

    largest_angle: float  # radians between them
    largest_ratio: float  # of that angle to the one of the second best


_SIFT = Nearness(largest_angle=0.7, largest_ratio=0.8)


@dataclass(frozen=True)
class Features:
    """The features of a photo, the most reliable first: of SIFT the largest, of a network those of highest score."""

    xy: np.ndarray  # [N, 2] float64 pixels of the sensor's frame, pixel centres at +0.5
    descriptors: np.ndarray  # [N, 128]: uint8 roots of SIFT's histograms (RootSIFT), or a network's float32
    nearness: Nearness = _SIFT

    def unit(self, count: int | None = None) -> np.ndarray:
        """Return `[N, 128]` float32 unit vectors of the first `count` features, or of all."""
        vectors = self.descriptors[:count].astype(np.float32)
        return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.float32(1e-6))


def find_features(photos: list[SourcePhoto], progress: Progress) -> list[Features]:
    """Return the features of every photo, detected at a longer side of at most `LONGEST_SIDE`, where its mask is on.

    Raises:
        InputError: A photo or its mask is damaged; the message names it.
    """
    cv2.setNumThreads(1)  # Several photos at once use the cores better than parts of one photo.
    return map_with_bar(_features, photos, progress, "features", "photo", _MOST_READERS)


Region = Callable[[Any], np.ndarray]
"""Rows of N features of one photo -> `[N, M]` bool, pairs with M features of another that the geometry rules out."""


def match(
    a: np.ndarray, b: np.ndarray, within: tuple[Region, Region] | None = None, nearness: Nearness = _SIFT
) -> np.ndarray:
    """`[K, 2]` uint32 rows of unit vectors `[N, 128]` and `[M, 128]` that are clearly each other's nearest.

    `within` has the regions to search: for `a` in b's photo, and for `b` in a's. None: everywhere.
    """
    if min(len(a), len(b)) < 2:
        return np.empty((0, 2), np.uint32)
    in_b, in_a = within or (None, None)
    nearest = _nearest(a, b, in_b, nearness)
    rows = np.flatnonzero(nearest >= 0)
    columns, column = np.unique(nearest[rows], return_inverse=True)
    returned = _nearest(b[columns], a, in_a and (lambda block: in_a(columns[block])), nearness)
    return np.stack([rows, nearest[rows]], axis=-1)[returned[column] == rows].astype(np.uint32)


def epipolar_regions(a: Features, b: Features, fundamental: np.ndarray) -> tuple[Region, Region]:
    """Return the regions along epipolar lines, of two photos whose pixels satisfy `b^T F a = 0`; F is `[3, 3]`."""

    def region(xy: np.ndarray, others: np.ndarray, matrix: np.ndarray) -> Region:
        lines, points = _homogeneous(xy) @ matrix.T, _homogeneous(others).astype(np.float32)
        lines = lines / np.maximum(np.linalg.norm(lines[:, :2], axis=1, keepdims=True), 1e-12)
        lines = lines.astype(np.float32)
        return lambda rows: np.abs(lines[rows] @ points.T) > _MOST_OFF

    return region(a.xy, b.xy, fundamental), region(b.xy, a.xy, fundamental.T)


def homography_regions(a: Features, b: Features, homography: np.ndarray) -> tuple[Region, Region]:
    """Return the regions about single points, of two photos whose pixels satisfy `b = H a` up to scale; H is `[3, 3]`.

    That holds where all of both photos shows one plane.
    """

    def region(xy: np.ndarray, others: np.ndarray, matrix: np.ndarray) -> Region:
        moved, others = _homogeneous(xy) @ matrix.T, others.astype(np.float32)
        points = moved[:, :2] / np.where(np.abs(moved[:, 2:]) > 1e-9, moved[:, 2:], 1e-9)
        points = points.astype(np.float32)
        return lambda rows: np.sum((points[rows][:, None] - others) ** 2, axis=-1) > _MOST_OFF**2

    return region(a.xy, b.xy, homography), region(b.xy, a.xy, np.linalg.inv(homography))


def _homogeneous(xy: np.ndarray) -> np.ndarray:
    return np.c_[xy, np.ones(len(xy))]


def _features(photo: SourcePhoto) -> Features:
    colors, mask = photo.read()[0], photo.read_mask()
    grey = cv2.cvtColor(colors, cv2.COLOR_RGB2GRAY)
    height, width = grey.shape
    reduced = max(1.0, max(width, height) / LONGEST_SIDE)
    grey = resize(grey, max(1, round(width / reduced)), max(1, round(height / reduced)))
    sift = cv2.SIFT_create(contrastThreshold=_CONTRAST, enable_precise_upscale=True)
    allowed = None if mask is None else usable(mask, *grey.shape[::-1])
    keypoints = sorted(sift.detect(grey, allowed), key=lambda keypoint: -keypoint.size)[:MOST_FEATURES]
    if not keypoints:
        return Features(np.empty((0, 2)), np.empty((0, 128), np.uint8))
    keypoints, histograms = sift.compute(grey, keypoints)
    histograms /= np.maximum(histograms.sum(axis=1, keepdims=True), 1e-6)
    scale = np.array([width / grey.shape[1], height / grey.shape[0]])
    xy = (np.array([keypoint.pt for keypoint in keypoints], np.float64) + 0.5) * scale
    return Features(xy, np.minimum(np.rint(np.sqrt(histograms) * 512), 255).astype(np.uint8))


def usable(mask: np.ndarray, width: int, height: int) -> np.ndarray:
    """Reduce a mask `[H, W]` to `[height, width]` uint8: 255 where the mask is on in all of a reduced pixel, else 0."""
    on = np.where(mask >= 128, np.float32(255), np.float32(0))
    return np.where(resize(on, width, height) > 254.5, np.uint8(255), np.uint8(0))


def _nearest(a: np.ndarray, b: np.ndarray, region: Region | None, nearness: Nearness) -> np.ndarray:
    """Return `[N]` the row of `b` nearest to each of `a`; -1 where it is too far or hardly nearer than the second."""
    nearest = np.empty(len(a), np.int64)
    for start in range(0, len(a), _BLOCK):
        block = slice(start, start + _BLOCK)
        cosines = a[block] @ b.T
        if region is not None:
            cosines[region(block)] = -1
        rows = np.arange(len(cosines))
        best = cosines.argmax(axis=1)
        first = np.arccos(np.clip(cosines[rows, best], -1, _ALIKE))
        cosines[rows, best] = -1
        second = np.arccos(np.clip(cosines.max(axis=1), -1, _ALIKE))
        is_clear = (first < nearness.largest_angle) & (first < nearness.largest_ratio * second)
        nearest[block] = np.where(is_clear, best, -1)
    return nearest
