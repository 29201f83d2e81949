"""Features and matches by networks in ONNX files, run by OpenCV 5: ALIKED or DISK, and LightGlue."""

import math
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from gsjax.errors import InputError
from gsjax.io.images import cv2, resize
from gsjax.io.parallel_map import Progress, map_with_bar, thread_count
from gsjax.io.sfm.features import MOST_FEATURES, Features, Nearness, usable
from gsjax.io.sfm.source_photos import SourcePhoto, turned_points

# The bounds that COLMAP has for ALIKED (src/colmap/feature/aliked.h), as an angle.
_NEARNESS = Nearness(largest_angle=math.acos(0.85), largest_ratio=1.0)


class Detector(NamedTuple):
    """A network of OpenCV's that finds features in a square picture."""

    name: str  # of OpenCV's class
    side: int  # pixels of the square, as OpenCV has it for the published files
    create: Callable[[str, int], Any]  # from a file's name and the side
    gain: float  # from OpenCV's pixels to those whose centres are at +0.5: gain * xy + 0.5


def _aliked(file: str, side: int) -> Any:
    params = cv2.ALIKED.Params()
    params.inputSize, params.engine = (side, side), cv2.dnn.ENGINE_AUTO
    return cv2.ALIKED.create(file, params)


def _disk(file: str, side: int) -> Any:
    return cv2.DISK.create(file, maxKeypoints=MOST_FEATURES, imageSize=(side, side))


DETECTORS = {
    # ALIKED's graph calls the first and last pixel's centres -1 and 1, OpenCV reads that as the picture's borders.
    "aliked": Detector("ALIKED", 640, _aliked, gain=639 / 640),
    "disk": Detector("DISK", 1024, _disk, gain=1.0),
}


def find_features(
    photos: list[SourcePhoto], kind: str, weights: Path, matcher_weights: Path | None, progress: Progress
) -> tuple[list[Features], Callable[[int, int], np.ndarray] | None]:
    """Detect the features of every photo with a network, highest score first, where the photo's mask is on.

    The network sees each photo upright, reduced to fit its square and centred in it, neither stretched nor enlarged.
    Its kind is of `DETECTORS`; `matcher_weights` are LightGlue's. Both are ONNX files.

    Raises:
        InputError: OpenCV is too old, a file is no such network, or a photo or its mask is damaged (named).
    """
    cv2.setNumThreads(thread_count())
    detector = DETECTORS[kind]
    network = _load(detector.name, weights, lambda file: detector.create(file, detector.side))
    glue = matcher_weights and _load(
        "LightGlueMatcher", matcher_weights, lambda file: cv2.LightGlueMatcher.create(file)
    )
    features = map_with_bar(
        lambda photo: _features(network, detector, weights, photo), photos, progress, "features", "photo", most=1
    )
    return features, matcher_weights and _light_glue(glue, matcher_weights, photos, features)


def _light_glue(
    matcher: Any, weights: Path, photos: list[SourcePhoto], features: list[Features]
) -> Callable[[int, int], np.ndarray]:
    """Return a function of two photos that matches their features by LightGlue: `[K, 2]` uint32 rows of these."""
    one_at_a_time = Lock()  # OpenCV's matcher holds the pair.

    def in_square(index: int) -> tuple[np.ndarray, int]:
        """Return `[N, 2]` float32 pixels of the square about the upright photo, and its side."""
        photo = photos[index]
        side, size = max(photo.size), np.array(photo.size)
        xy = features[index].xy + (side - size) / 2
        return turned_points(xy, side, side, photo.to_upright).astype(np.float32), side

    def matched(i: int, j: int) -> np.ndarray:
        a, b = features[i], features[j]
        if min(len(a.xy), len(b.xy)) == 0:
            return np.empty((0, 2), np.uint32)
        (first, side), (second, other) = in_square(i), in_square(j)
        with one_at_a_time:
            try:
                matcher.setPairInfo(first, second, (side, side), (other, other))
                matches = matcher.match(a.unit(), b.unit())
            except cv2.error as error:
                raise _unlike("LightGlue", weights, error) from error
        return np.array([(match.queryIdx, match.trainIdx) for match in matches], np.uint32).reshape(-1, 2)

    return matched


def _features(network: Any, detector: Detector, weights: Path, photo: SourcePhoto) -> Features:
    colors, mask = photo.read_upright(), photo.read_mask()
    height, width = colors.shape[:2]
    reduced = max(1.0, max(width, height) / detector.side)
    small = resize(colors, max(1, round(width / reduced)), max(1, round(height / reduced)))
    size = np.array(small.shape[1::-1])
    margin = (detector.side - size) // 2
    (left, top), (right, bottom) = margin.tolist(), (detector.side - size - margin).tolist()
    # Continued outwards rather than blackened: the photo's border must not look like an edge of the scene.
    square = cv2.copyMakeBorder(small, top, bottom, left, right, cv2.BORDER_REPLICATE)
    try:
        keypoints, descriptors = network.detectAndCompute(np.ascontiguousarray(square[..., ::-1]), None)
    except cv2.error as error:
        raise _unlike(detector.name, weights, error) from error
    if not keypoints:
        return Features(np.empty((0, 2)), np.empty((0, 128), np.float32), _NEARNESS)
    in_square = np.array([keypoint.pt for keypoint in keypoints], np.float64) * detector.gain + 0.5
    xy = in_square - margin
    allowed = np.full(small.shape[:2], 255, np.uint8) if mask is None else usable(photo.upright(mask), *size.tolist())
    rows = np.flatnonzero(((xy >= 0) & (xy < size)).all(axis=1))
    column, row = xy[rows].astype(int).T
    rows = rows[allowed[row, column] > 0]
    responses = np.array([keypoint.response for keypoint in keypoints])
    rows = rows[np.argsort(-responses[rows], kind="stable")][:MOST_FEATURES]
    xy = turned_points(xy[rows] * ([width, height] / size), width, height, -photo.to_upright % 4)
    return Features(xy, descriptors[rows], _NEARNESS)


def _load(name: str, weights: Path, create: Callable[[str], Any]) -> Any:
    """An object of OpenCV's class `name`."""
    if not hasattr(cv2, name):
        install = "pip install -U opencv-contrib-python-headless"
        raise InputError(f"OpenCV {cv2.__version__} has no {name}; version 5.0 or newer is needed: {install}")
    try:
        return create(str(weights))
    except cv2.error as error:
        raise InputError(f"{weights}: no ONNX graph that OpenCV {cv2.__version__} loads ({_reason(error)})") from error


def _unlike(network: str, weights: Path, error: Exception) -> InputError:
    return InputError(f"{weights}: is no graph of {network} as OpenCV {cv2.__version__} runs it ({_reason(error)})")


def _reason(error: Any) -> str:
    return " ".join(str(error.err or error).split())
