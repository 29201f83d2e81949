"""SIFT features of photos, and matches of the nearest descriptors.

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

MOST_FEATURES = 4096  # a photo
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
    """What is told apart in a photo, what lasts longest first: of SIFT the largest, of a network the most certain."""

    xy: np.ndarray  # [N, 2] float64 pixels of the sensor's frame, pixel centres at +0.5
    descriptors: np.ndarray  # [N, 128]: uint8 roots of SIFT's histograms (RootSIFT), or a network's float32
    nearness: Nearness = _SIFT

    def unit(self, count: int | None = None) -> np.ndarray:
        """`[N, 128]` float32 unit vectors of the first `count` features, or of all."""
        vectors = self.descriptors[:count].astype(np.float32)
        return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.float32(1e-6))


def find_features(
    shots: list[Shot], max_image_size: int, threads: int, progress: Callable[..., tqdm]
) -> list[Features]:
    """The features of every photo, sought at a longer side of at most `max_image_size` pixels, where its mask is on.

    Raises:
        InputError: A photo or its mask is damaged; it is named.
    """
    cv2.setNumThreads(1)  # Photos side by side use the cores better than parts of one photo.
    with (
        ThreadPoolExecutor(min(threads, _MOST_READERS)) as pool,
        progress(total=len(shots), desc="features", unit="photo") as bar,
    ):
        found = []
        for features in pool.map(lambda shot: _features(shot.read()[0], shot.read_mask(), max_image_size), shots):
            found.append(features)
            bar.update(1)
    return found


class Lines(NamedTuple):
    """Where matches of each feature of one photo may lie in another: along its epipolar line."""

    lines: np.ndarray  # [N, 3] float32, of unit normal, in pixels of the other photo
    points: np.ndarray  # [M, 3] float32 homogeneous pixels of the other photo's features

    def of(self, rows) -> "Lines":
        """For some of the features only."""
        return Lines(self.lines[rows], self.points)

    def too_far(self) -> np.ndarray:
        """`[N, M]` bool, pairs of features that the geometry rules out."""
        return np.abs(self.lines @ self.points.T) > _MOST_OFF


class Spots(NamedTuple):
    """Where matches of each feature of one photo may lie in another: about one place, as all of it shows one plane."""

    spots: np.ndarray  # [N, 2] float32 pixels of the other photo
    points: np.ndarray  # [M, 2] float32 pixels of the other photo's features

    def of(self, rows) -> "Spots":
        """For some of the features only."""
        return Spots(self.spots[rows], self.points)

    def too_far(self) -> np.ndarray:
        """`[N, M]` bool, pairs of features that the geometry rules out."""
        x, y = (self.spots[:, None, axis] - self.points[None, :, axis] for axis in range(2))
        return x * x + y * y > _MOST_OFF**2


Region = Lines | Spots


def match(
    a: np.ndarray, b: np.ndarray, within: tuple[Region, Region] | None = None, nearness: Nearness = _SIFT
) -> np.ndarray:
    """Rows of two sets of unit vectors that are each other's nearest, and clearly nearer than the second nearest.

    Args:
        a: `[N, 128]` float32.
        b: `[M, 128]` float32.
        within: Where to look: for `a` in b's photo, and for `b` in a's. None: everywhere.
        nearness: How near is near, and how much nearer is clear.

    Returns:
        `[K, 2]` uint32 rows of `a` and `b`.
    """
    if min(len(a), len(b)) < 2:
        return np.empty((0, 2), np.uint32)
    there, back = within or (None, None)
    nearest = _nearest(a, b, there, nearness)
    rows = np.flatnonzero(nearest >= 0)
    columns, column = np.unique(nearest[rows], return_inverse=True)
    returned = _nearest(b[columns], a, back and back.of(columns), nearness)
    return np.stack([rows, nearest[rows]], axis=-1)[returned[column] == rows].astype(np.uint32)


def along_lines(a: Features, b: Features, fundamental: np.ndarray) -> tuple[Lines, Lines]:
    """Where to look in two photos whose pixels satisfy `b^T F a = 0`, `fundamental` being F, `[3, 3]`."""
    points_a, points_b = _homogeneous(a.xy), _homogeneous(b.xy)
    lines_b, lines_a = points_a @ fundamental.T, points_b @ fundamental
    return _lines(lines_b, points_b), _lines(lines_a, points_a)


def at_spots(a: Features, b: Features, homography: np.ndarray) -> tuple[Spots, Spots]:
    """Where to look in two photos whose pixels satisfy `b = H a` up to scale, `homography` being H, `[3, 3]`."""
    return _spots(a.xy, b.xy, homography), _spots(b.xy, a.xy, np.linalg.inv(homography))


def _lines(lines: np.ndarray, points: np.ndarray) -> Lines:
    lines = lines / np.maximum(np.linalg.norm(lines[:, :2], axis=1, keepdims=True), 1e-12)
    return Lines(lines.astype(np.float32), points.astype(np.float32))


def _spots(xy: np.ndarray, points: np.ndarray, homography: np.ndarray) -> Spots:
    moved = _homogeneous(xy) @ homography.T
    depth = moved[:, 2:]
    spots = moved[:, :2] / np.where(np.abs(depth) > 1e-9, depth, 1e-9)
    return Spots(spots.astype(np.float32), points.astype(np.float32))


def _homogeneous(xy: np.ndarray) -> np.ndarray:
    return np.c_[xy, np.ones(len(xy))]


def _features(colors: np.ndarray, mask: np.ndarray | None, max_image_size: int) -> Features:
    grey = cv2.cvtColor(colors, cv2.COLOR_RGB2GRAY)
    height, width = grey.shape
    reduced = max(1.0, max(width, height) / max_image_size)
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
    """A mask `[H, W]` for the reduced photo, `[height, width]` uint8.

    It is 255 where all that a pixel of the reduced photo is the mean of may be used, else 0.
    """
    on = np.where(mask >= 128, np.float32(255), np.float32(0))
    return np.where(resize(on, width, height) > 254.5, np.uint8(255), np.uint8(0))


def _nearest(a: np.ndarray, b: np.ndarray, region: Region | None, nearness: Nearness) -> np.ndarray:
    """`[N]` the row of `b` nearest to each of `a`, or -1 where it is too far off or hardly nearer than the second."""
    nearest = np.empty(len(a), np.int64)
    for start in range(0, len(a), _BLOCK):
        block = slice(start, start + _BLOCK)
        cosines = a[block] @ b.T
        if region is not None:
            cosines[region.of(block).too_far()] = -1
        rows = np.arange(len(cosines))
        best = cosines.argmax(axis=1)
        first = np.arccos(np.clip(cosines[rows, best], -1, _ALIKE))
        cosines[rows, best] = -1
        second = np.arccos(np.clip(cosines.max(axis=1), -1, _ALIKE))
        is_clear = (first < nearness.largest_angle) & (first < nearness.largest_ratio * second)
        nearest[block] = np.where(is_clear, best, -1)
    return nearest
