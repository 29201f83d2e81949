"""What the effects are judged by: keypoints of the tracks with their colours, and a few numbers of every photo.

Photos are read one by one and forgotten. Colours come from a slightly blurred photo, so that a keypoint that is off by
part of a pixel does not matter.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from gsjax.scene import Frame, Scene, tracks_by_name
from gsjax.scene.georeference import up_of_cameras

BLUR = 0.7  # pixels, standard deviation: wider windows mix what is behind an edge into it, more so in small photos
DARKEST, BRIGHTEST = 12, 243  # Beyond, a pixel is clipped or nearly so, and tells no ratio:
CLIPPED = 0.02  # most of a window that such pixels may make up
EDGE_LINES, EDGE_REACH, EDGE_CONTRAST = 200, 6, 38.0  # rows and columns searched; pixels around an edge; levels
SHARPEST, FEWEST_EDGES = 0.1, 50  # of the edges, whose width counts; of a photo whose edges count
SKY_BRIGHT, SKY_SMOOTH = 0.5, 0.02  # Of a pixel that may be sky: its luminance, and how far its neighbours differ.
SKY_CLEAR = 0.1  # of the width: nothing was matched nearer to it
MOST_POINTS = 3000  # whose colours are looked at, and
POINTS_PER_PHOTO = 40  # where there are many photos
EVEN_GRID = 320  # most places along it where a photo is tested for being even:
EVEN_STEP = 0.06  # so far the places around it differ at most, in any channel
LIGHT_GRID = 96  # most places along it whose mean colour is kept, and which are bare or not
UPRIGHT = 0.5  # length of the mean of the cameras' upward axes, under which they do not agree on up
UNUSABLE, UNEVEN, EVEN = 0, 1, 2

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


class PhotoFacts(NamedTuple):
    """What is kept of one photo."""

    sharpness: float  # of the luminance over valid pixels, see `_sharpness`
    edge_width: float  # pixels, of the sharpest tenth of its edges; 0 where it has too few
    bare: np.ndarray  # [h, w] bool by place of a grid of `light_stride` pixels: bright, smooth and far from all matches
    sky_share: float  # of the valid places that are bare
    sky_color: np.ndarray  # [3] mean of them, 0..1
    sky_spread: float  # standard deviation of them, of the channel that has most
    has_matte: bool
    even: np.ndarray  # [h, w] uint8 by place of a grid of `even_stride` pixels: UNUSABLE, UNEVEN or EVEN
    light: np.ndarray  # [h, w, 3] float16 mean display-coded colours of the same grid, 0..255


@dataclass(frozen=True)
class Observations:
    """O observations of tracks with a usable colour, in V photos."""

    frames: tuple[Frame, ...]
    facts: tuple[PhotoFacts, ...]  # a frame
    points: np.ndarray  # [P, 3] float64 world
    photo: np.ndarray  # [O] index of the frame
    point: np.ndarray  # [O] index of the point
    pixels: np.ndarray  # [O, 2] float64 keypoint in the frame
    colors: np.ndarray  # [O, 3] float64 display-coded, 0..1; NaN where a channel is clipped or masked
    tracked: bool  # whether any point was matched in any photo

    @property
    def radii2(self) -> np.ndarray:
        """`[O]` squared distance from the principal point, 1 at half the diagonal of the frame."""
        halves = np.array([(frame.width**2 + frame.height**2) / 4 for frame in self.frames])
        centers = np.array([frame.K[:2, 2] for frame in self.frames])
        return np.square(self.pixels - centers[self.photo]).sum(-1) / halves[self.photo]

    @property
    def tangents2(self) -> np.ndarray:
        """`[O]` squared tangent of the angle to the optical axis."""
        focals = np.array([np.diag(frame.K)[:2] for frame in self.frames])
        centers = np.array([frame.K[:2, 2] for frame in self.frames])
        return np.square((self.pixels - centers[self.photo]) / focals[self.photo]).sum(-1)


def observe(scene: Scene, *, progress: Callable[[Iterable[Frame]], Iterable[Frame]] = iter) -> Observations:
    """Read every photo once; `progress` wraps the frames, for a bar. The observations are ordered by photo.

    Raises:
        InputError: A photo cannot be read.
    """
    by_name = tracks_by_name(scene)
    in_sample = np.zeros(len(scene.points), bool)
    most = max(MOST_POINTS, POINTS_PER_PHOTO * len(scene.frames))
    in_sample[np.random.default_rng(0).permutation(len(scene.points))[:most]] = True
    facts, parts = [], []
    for index, frame in enumerate(progress(scene.frames)):
        points, rays = by_name.get(frame.name, (np.empty(0, np.int64), np.empty((0, 2))))
        pixels = rays * frame.K[[0, 1], [0, 1]] + frame.K[:2, 2]
        inside = ((pixels >= 0) & (pixels < [frame.width, frame.height])).all(-1)
        is_used = inside & in_sample[points]
        colors, photo_facts = _look(frame, pixels[inside], pixels[is_used])
        facts.append(photo_facts)
        parts.append((np.full(len(colors), index), points[is_used], pixels[is_used], colors))
    photo, point, pixels, colors = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return Observations(
        scene.frames, tuple(facts), scene.points.astype(np.float64), photo, point, pixels, colors, bool(len(photo))
    )


def upwards(frames: Sequence[Frame]) -> np.ndarray | None:
    """`[3]` unit, where up is by photos that are upright as they are stored; None where they contradict each other."""
    viewmats = np.stack([frame.viewmat for frame in frames]).astype(np.float64)
    if np.linalg.norm(viewmats[:, 1, :3].mean(0)) < UPRIGHT:
        return None
    return up_of_cameras(viewmats)[0]


def _look(frame: Frame, keypoints: np.ndarray, looked_at: np.ndarray) -> tuple[np.ndarray, PhotoFacts]:
    image, matte, valid = frame.pixels()
    usable = np.ones(image.shape[:2], bool) if valid is None else valid > 127
    if matte is not None:
        usable = usable & (matte > 254)
    luminance = image.astype(np.float32) @ _LUMINANCE.astype(np.float32)
    facts = PhotoFacts(
        _sharpness(luminance, usable),
        edge_width(luminance, usable),
        *_sky(image, luminance, usable, keypoints),
        matte is not None,
        _even(image, usable),
        block_means(image, light_stride(image.shape[1], image.shape[0])).astype(np.float16),
    )
    return _blurred_at(image, usable, looked_at), facts


def _blurred_at(image: np.ndarray, usable: np.ndarray, keypoints: np.ndarray) -> np.ndarray:
    """`[O, 3]` colours 0..1 under a Gaussian window at the keypoints; NaN where it meets what cannot be used."""
    if not len(keypoints):
        return np.empty((0, 3))
    reach = int(np.ceil(2 * BLUR))
    offsets = np.arange(-reach, reach + 1)
    x, y = np.floor(keypoints).astype(int).T
    columns = np.clip(x[:, None] + offsets, 0, image.shape[1] - 1)
    rows = np.clip(y[:, None] + offsets, 0, image.shape[0] - 1)
    window = np.exp(-0.5 * (offsets / BLUR) ** 2)
    window /= window.sum()

    def blurred(pixels: np.ndarray) -> np.ndarray:
        return np.einsum("oyx...,y,x->o...", pixels[rows[:, :, None], columns[:, None, :]], window, window)

    clipped = (image < DARKEST) | (image > BRIGHTEST)
    unusable = blurred((clipped.any(-1) | ~usable).astype(np.float64)) > CLIPPED
    colors = blurred(image) / 255.0
    fine = ~unusable & ((colors > DARKEST / 255) & (colors < BRIGHTEST / 255)).all(-1)
    return np.where(fine[:, None], colors, np.nan)


def _sharpness(luminance: np.ndarray, usable: np.ndarray) -> float:
    """Variance of the Laplacian over the mean squared slope: what a photo shows matters little, its blur much.

    The variance alone, the customary measure, halves where half as many edges are in view.
    """
    if min(luminance.shape) < 3:
        return 0.0
    middle = luminance[1:-1, 1:-1]
    left, right = luminance[1:-1, :-2], luminance[1:-1, 2:]
    up, down = luminance[:-2, 1:-1], luminance[2:, 1:-1]
    inner: np.ndarray = np.asarray(ndimage.binary_erosion(usable))[1:-1, 1:-1]
    if not inner.any():
        return 0.0
    laplacian: np.ndarray = left + right + up + down - 4 * middle
    slopes: np.ndarray = np.square(right - left) + np.square(down - up)
    return float(laplacian[inner].var(dtype=np.float64) / max(slopes[inner].mean(dtype=np.float64), 1e-6))


def edge_width(luminance: np.ndarray, usable: np.ndarray) -> float:
    """`PhotoFacts.edge_width`: contrast around an edge over its steepest step, along some rows and columns.

    An ideal edge is one pixel wide, one under a Gaussian blur of s pixels 2.5 s. It takes no other photo to compare.
    """
    widths = []
    for lines, free in ((luminance, usable), (luminance.T, usable.T)):
        sampling = slice(None, None, max(1, len(lines) // EDGE_LINES))
        widths.append(_widths(lines[sampling], free[sampling]))
    every = np.concatenate(widths)
    return float(np.quantile(every, SHARPEST)) if len(every) >= FEWEST_EDGES else 0.0


def _widths(lines: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Widths of the edges along lines `[L, N]`: where a step is the steepest within reach."""
    if lines.shape[1] < 2 * EDGE_REACH:
        return np.empty(0)
    size, slopes = 2 * EDGE_REACH, np.abs(np.diff(lines, axis=1))
    contrast = (ndimage.maximum_filter1d(lines, size, axis=1) - ndimage.minimum_filter1d(lines, size, axis=1))[:, 1:]
    whole = ndimage.minimum_filter1d(usable.astype(np.uint8), size, axis=1)[:, 1:] == 1
    is_edge = whole & (contrast > EDGE_CONTRAST) & (slopes == ndimage.maximum_filter1d(slopes, size - 1, axis=1))
    return contrast[is_edge] / slopes[is_edge]


def _sky(
    image: np.ndarray, luminance: np.ndarray, usable: np.ndarray, keypoints: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray, float]:
    """Which places of a grid are bright, smooth and far from all matches, their share, mean colour and spread."""
    height, width = luminance.shape
    step = light_stride(width, height)
    rows = np.arange(height // step) * step + step // 2
    columns = np.arange(width // step) * step + step // 2
    grid = np.ix_(rows, columns)
    reach = np.array([-2, 0, 2])
    near_rows, near_columns = (
        np.clip(at[:, None] + reach, 0, side - 1) for at, side in ((rows, height), (columns, width))
    )
    around = luminance[near_rows[:, None, :, None], near_columns[None, :, None, :]]  # [rows, columns, 3, 3]
    sky = usable[grid] & (luminance[grid] > 255 * SKY_BRIGHT) & (np.ptp(around, axis=(2, 3)) < 255 * SKY_SMOOTH)
    free = np.ones((height // step + 2, width // step + 2), bool)
    if len(keypoints):
        x, y = (keypoints / step).astype(int).T
        free[y, x] = False
        distance = np.asarray(ndimage.distance_transform_edt(free))[: len(rows), : len(columns)]
        sky &= distance * step > SKY_CLEAR * width
    colors = image[grid][sky] / 255.0 if sky.any() else np.zeros((1, 3))
    return sky, float(sky.sum() / max(usable[grid].sum(), 1)), colors.mean(0), float(colors.std(0).max())


def even_stride(width: int, height: int) -> int:
    """Pixels along the side of a place where a photo is tested for being even."""
    return max(1, -(-max(width, height) // EVEN_GRID))


def _even(image: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """`PhotoFacts.even`, from the mean colours of the places."""
    stride = even_stride(image.shape[1], image.shape[0])
    colors = block_means(image, stride)
    step = ndimage.maximum_filter(colors, (3, 3, 1)) - ndimage.minimum_filter(colors, (3, 3, 1))
    whole = block_means(usable, stride) == 1
    even = np.where(step.max(axis=-1) < 255 * EVEN_STEP, np.uint8(EVEN), np.uint8(UNEVEN))
    return np.where(whole, even, np.uint8(UNUSABLE))


def block_means(values: np.ndarray, stride: int) -> np.ndarray:
    """`[h, w, ...]` float32 means of whole blocks of `stride` by `stride` pixels of `[H, W, ...]`."""
    height, width = values.shape[0] // stride, values.shape[1] // stride
    blocks = values[: height * stride, : width * stride].reshape(height, stride, width, stride, *values.shape[2:])
    return blocks.mean(axis=(1, 3), dtype=np.float32)


def light_stride(width: int, height: int) -> int:
    """Pixels along the side of a place of `PhotoFacts.light`."""
    return max(1, -(-max(width, height) // LIGHT_GRID))
