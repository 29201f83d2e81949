"""Lenses, and the pinhole views that represent them: every camera model COLMAP knows, by one general map.

A target pixel's ray is sent through the lens model to the place in the photo where it was recorded; OpenCV reads it
there. No model needs code of its own.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.images import cv2
from gsjax.io.machine import require_memory
from gsjax.io.packages import require
from gsjax.scene.similarity import is_float32

# Models of one focal length: the same model with two, and how many coefficients that one has more, all zero.
_WITH_TWO_FOCALS = {
    "SIMPLE_PINHOLE": ("PINHOLE", 0),
    "SIMPLE_RADIAL": ("OPENCV", 3),
    "RADIAL": ("OPENCV", 2),
    "SIMPLE_DIVISION": ("DIVISION", 0),
    "SIMPLE_FISHEYE": ("FISHEYE", 0),
    "SIMPLE_RADIAL_FISHEYE": ("OPENCV_FISHEYE", 3),
    "RADIAL_FISHEYE": ("OPENCV_FISHEYE", 2),
}
_LARGEST_SIDE = 2**31  # pixels
_FARTHEST_MIDDLE = 100  # sides of the photo
_SHORTEST_FOCAL = 0.02  # longer sides of the photo: of a fisheye lens of 220 degrees it is a quarter
_LONGEST_REMAPPED = 32_766  # pixels: OpenCV counts them in 16 bits
_MAPPED = 100  # bytes a pixel while a lens's map is made
_WIDEST = np.radians(60.0)  # from the axis, at a fisheye photo's corners: beyond, one plane loses too much of it
_ALIKE = np.radians(0.1)  # between a ray and that which the lens gives back for its pixel; a fold gives another
_NO_REMAP_BELOW = 0.01  # pixels: a lens that moves nothing farther is read as it is


@dataclass(frozen=True)
class Lens:
    """A camera as COLMAP describes it; hashable, so that what follows from it is computed once for many photos."""

    model: str  # COLMAP's name, for example "OPENCV"
    width: int  # pixels
    height: int  # pixels
    params: tuple[float, ...]  # in COLMAP's order
    reach: float = math.inf  # of the width, from the principal point: farther out photos are black (image circle)


@dataclass(frozen=True)
class PinholeView:
    """A pinhole image that can be read out of a photo."""

    suffix: str  # added to the photo's name; "" where a photo gives one view only
    rotation: np.ndarray  # [3, 3] float64, photo's camera axes to the view's
    K: np.ndarray  # [3, 3] float64 pixels
    width: int
    height: int
    source_xy: np.ndarray | None  # [H, W, 2] float32 pixels of the photo, centres at +0.5; None: the photo itself
    valid: np.ndarray | None  # [H, W] uint8, 0 where the photo shows nothing; None: everywhere valid

    def warp(self, array: np.ndarray) -> np.ndarray:
        """The view's pixels of an array `[H, W]` or `[H, W, C]` of the photo's size, bilinear."""
        if self.source_xy is None:
            return array
        source = self.source_xy - np.float32(0.5)
        return cv2.remap(array, source, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def check_lens(lens: Lens, where: str | Path) -> Lens:
    """The lens itself, once its size and numbers are found usable; else InputError, which begins with `where`."""
    first = 1 if lens.model in _WITH_TWO_FOCALS else 2
    focals, center, size = lens.params[:first], lens.params[first : first + 2], (lens.width, lens.height)
    is_panorama = lens.model == "EQUIRECTANGULAR"
    offsets = [] if is_panorama else [abs(at / side - 0.5) for at, side in zip(center, size, strict=True) if side]
    if not (0 < lens.width < _LARGEST_SIDE and 0 < lens.height < _LARGEST_SIDE):
        fault = "a size that no photo has"
    elif not is_float32(np.array(lens.params)).all():
        fault = "a parameter that is not finite"
    elif min(focals) <= 0:
        fault = "a focal length that is not positive"
    elif not is_panorama and min(focals) < _SHORTEST_FOCAL * max(size):
        fault = "a focal length that is too short for its size; both are counted in pixels"
    elif max(offsets, default=0) >= _FARTHEST_MIDDLE:  # So far off, no crop of a larger photo has it.
        fault = f"a principal point that is {_FARTHEST_MIDDLE} times its size away"
    else:
        return lens
    numbers = ", ".join(f"{value:.6g}" for value in lens.params)
    raise InputError(f"{where} ({lens.model} {lens.width}x{lens.height} with {numbers}) has {fault}")


def resize_lens(lens: Lens, width: int, height: int) -> Lens:
    """The lens of the same photo resized to `width` x `height` pixels.

    Focal lengths and the principal point are scaled per axis; distortion acts on the ray and stays. Where the axes'
    factors differ, a model of one focal length becomes its sibling of two, so nothing is rounded.
    """
    across, down = width / lens.width, height / lens.height
    if lens.model == "EQUIRECTANGULAR":
        return Lens(lens.model, width, height, (float(width), float(height)))
    resized = replace(lens, width=width, height=height)
    if lens.model not in _WITH_TWO_FOCALS:
        fx, fy, cx, cy, *distortion = lens.params
        return replace(resized, params=(fx * across, fy * down, cx * across, cy * down, *distortion))
    focal, cx, cy, *distortion = lens.params
    if across == down:
        return replace(resized, params=(focal * across, cx * across, cy * down, *distortion))
    model, zeros = _WITH_TWO_FOCALS[lens.model]
    params = (focal * across, focal * down, cx * across, cy * down, *distortion, *[0.0] * zeros)
    return replace(resized, model=model, params=params)


def camera_points(lens: Lens, pixels: np.ndarray) -> np.ndarray:
    """`[N, 2]` float64 x/z and y/z of the rays to `[N, 2]` float64 pixels; NaN where the lens has none."""
    if lens.model in ("PINHOLE", "SIMPLE_PINHOLE"):
        return _rays(pixels, _pinhole_matrix(lens))[:, :2]
    return np.asarray(pycolmap_camera(lens).cam_from_img(pixels), np.float64)[:, :2]


def _pinhole_matrix(lens: Lens) -> np.ndarray:
    fx, fy, cx, cy = lens.params if lens.model == "PINHOLE" else (lens.params[0], *lens.params)
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def pycolmap_camera(lens: Lens):
    """The lens as a `pycolmap.Camera`."""
    pycolmap = require("pycolmap")
    return pycolmap.Camera(model=lens.model, width=lens.width, height=lens.height, params=list(lens.params))


@lru_cache(maxsize=2)
def pinhole_views(lens: Lens) -> tuple[PinholeView, ...]:
    """The pinhole views of a lens: one, or faces of a cube, each of 90 degrees.

    A full panorama (EQUIRECTANGULAR) has all six; a fisheye photo whose corners are farther than 60 degrees from the
    axis has what it covers of each. The one view keeps the lens's focal lengths and principal point, and its size less
    the rows and columns at the border that the photo does not cover.

    Raises:
        InputError: The parameters give no image around the principal point, or the photo is larger than memory has
            room for.
    """
    if lens.model in ("PINHOLE", "SIMPLE_PINHOLE"):
        return (PinholeView("", np.eye(3), _pinhole_matrix(lens), lens.width, lens.height, None, None),)
    _check_room(lens)
    camera = pycolmap_camera(lens)
    if lens.model == "EQUIRECTANGULAR" or ("FISHEYE" in lens.model and _corner_angle(camera) > _WIDEST):
        return _faces(lens)
    K = np.asarray(camera.calibration_matrix())
    target = _pixel_centres(lens.width, lens.height)
    source = _project(camera, _rays(target, K))
    if np.abs(source - target).max() < _NO_REMAP_BELOW:
        return (PinholeView("", np.eye(3), K, lens.width, lens.height, None, None),)
    valid = _covered(source, K, lens)
    rows, columns = _without_bare_border(valid)
    return (_cut(PinholeView("", np.eye(3), K, lens.width, lens.height, source, valid), rows, columns),)


def _cut(view: PinholeView, rows: slice, columns: slice) -> PinholeView:
    """Some rows and columns of a view. Its `source_xy` is not finite where the photo has no pixel; `valid` is bool."""
    assert view.source_xy is not None and view.valid is not None
    source, valid = view.source_xy[rows, columns], view.valid[rows, columns]
    return replace(
        view,
        K=view.K - np.array([[0, 0, columns.start], [0, 0, rows.start], [0, 0, 0]]),
        width=valid.shape[1],
        height=valid.shape[0],
        source_xy=np.where(np.isfinite(source), source, -1.0).astype(np.float32),
        valid=None if valid.all() else valid.astype(np.uint8) * np.uint8(255),
    )


def _check_room(lens: Lens) -> None:
    """That the map of a lens fits into memory, and its photo into what OpenCV reads out by one."""
    photo = f"a photo of {lens.width}x{lens.height} pixels from a {lens.model} camera"
    if max(lens.width, lens.height) > _LONGEST_REMAPPED:
        raise InputError(f"{photo} is too long to be undistorted: {_LONGEST_REMAPPED} pixels a side are the most")
    side = lens.width / np.pi  # of a face of the cube
    pixels = 2 * side * side if lens.model == "EQUIRECTANGULAR" else lens.width * lens.height
    require_memory(f"undistorting {photo}", _MAPPED * pixels)


def principal_point(lens: Lens) -> np.ndarray:
    """`[2]` float64 pixels."""
    return np.asarray(pycolmap_camera(lens).calibration_matrix())[:2, 2]


def is_circular(lens: Lens) -> bool:
    """Whether a fisheye photo's corners are 90 degrees or more from the axis: its picture may be a circle within it."""
    return "FISHEYE" in lens.model and _corner_angle(pycolmap_camera(lens)) == math.inf


def _corner_angle(camera) -> float:
    """Radians between the axis and the farthest of a photo's corners; infinite where the lens does not reach one."""
    corners = np.array([[x, y] for x in (0.0, camera.width) for y in (0.0, camera.height)])
    rays = np.asarray(camera.cam_ray_from_img(image_points=corners))
    if not (np.isfinite(rays).all() and np.abs(camera.img_from_cam(rays) - corners).max() < 1):
        return math.inf
    return float(np.arccos(np.clip(rays[:, 2], -1, 1)).max())


def _faces(lens: Lens) -> tuple[PinholeView, ...]:
    """The faces of a cube that the photo covers, of 90 degrees each, cut to what it covers of each.

    Their pixels are as dense in the middle as a fisheye photo's middle, or as a panorama's equator.
    """
    camera, is_panorama = pycolmap_camera(lens), lens.model == "EQUIRECTANGULAR"
    side = max(2, round(lens.width / np.pi if is_panorama else 2 * camera.mean_focal_length()))
    K = np.array([[side / 2, 0, side / 2], [0, side / 2, side / 2], [0, 0, 1]])
    rays = _rays(_pixel_centres(side, side), K)
    faces = []
    for name, rotation in _face_rotations().items():
        source = _project(camera, rays @ rotation)
        valid = np.ones((side, side), bool) if is_panorama else _recorded(camera, source, rays @ rotation)
        if lens.reach < math.inf:
            valid &= np.linalg.norm(source - principal_point(lens), axis=-1) < lens.reach * lens.width
        if valid.any():
            rows, columns = (slice(at.min(), at.max() + 1) for at in np.nonzero(valid))
            faces.append(_cut(PinholeView(f"_{name}", rotation, K, side, side, source, valid), rows, columns))
    if not faces:
        raise InputError(f"camera {lens.model} with params {list(lens.params)} gives no image")
    return tuple(faces)


def _recorded(camera, source: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """`[H, W]` bool: the photo has the pixel of a ray `[H, W, 3]`, and the lens gives that ray back for it."""
    inside = np.isfinite(source).all(-1) & (source >= 0).all(-1) & (source <= [camera.width, camera.height]).all(-1)
    directions = rays[inside] / np.linalg.norm(rays[inside], axis=-1, keepdims=True)
    back = np.asarray(camera.cam_ray_from_img(image_points=np.ascontiguousarray(source[inside]))).reshape(-1, 3)
    recorded = np.zeros(source.shape[:2], bool)
    recorded[inside] = np.linalg.norm(np.where(np.isfinite(back), back, 0) - directions, axis=-1) < _ALIKE
    return recorded


def _face_rotations() -> dict[str, np.ndarray]:
    """Panorama's camera axes to the face's: turns about y (down) for the sides, about x for up and down."""
    x, y, z = np.eye(3)
    return {
        "front": np.stack([x, y, z]),
        "right": np.stack([-z, y, x]),
        "back": np.stack([-x, y, -z]),
        "left": np.stack([z, y, -x]),
        "up": np.stack([x, z, -y]),
        "down": np.stack([x, -z, y]),
    }


def _pixel_centres(width: int, height: int) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)


def _rays(pixels: np.ndarray, K: np.ndarray) -> np.ndarray:
    xy = (pixels - K[:2, 2]) / K[[0, 1], [0, 1]]
    return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)


def _project(camera, rays: np.ndarray) -> np.ndarray:
    """`[H, W, 2]` photo pixels of `[H, W, 3]` rays, NaN where the model has none."""
    flat = np.ascontiguousarray(rays.reshape(-1, 3), np.float64)
    return np.asarray(camera.img_from_cam(flat)).reshape(*rays.shape[:2], 2)


def _covered(source: np.ndarray, K: np.ndarray, lens: Lens) -> np.ndarray:
    """`[H, W]` bool: the ray hits the photo, in the part round the principal point where the lens does not fold.

    Polynomials turn round outside the field they were fitted to and would show the picture again, mirrored.
    """
    inside = np.isfinite(source).all(-1) & (source >= 0).all(-1) & (source <= [lens.width, lens.height]).all(-1)
    safe = np.where(np.isfinite(source), source, 0.0)
    (x_down, y_down), (x_right, y_right) = (np.moveaxis(g, -1, 0) for g in np.gradient(safe, axis=(0, 1)))
    unfolded = x_right * y_down - x_down * y_right > 0
    _, parts = cv2.connectedComponents((inside & unfolded).astype(np.uint8), connectivity=4)
    row = int(np.clip(K[1, 2], 0, lens.height - 1))
    column = int(np.clip(K[0, 2], 0, lens.width - 1))
    if parts[row, column] == 0:
        raise InputError(f"camera {lens.model} with params {list(lens.params)} gives no image at its principal point")
    return parts == parts[row, column]


def _without_bare_border(valid: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns left after cutting, worst side first, until no bare pixel is on the border.

    Where that would eat more than half of a side, nothing is cut, and `valid` alone marks them.
    """
    height, width = valid.shape
    top, bottom, left, right = 0, height, 0, width
    while 2 * (bottom - top) >= height and 2 * (right - left) >= width:
        window = valid[top:bottom, left:right]
        bare = [1 - side.mean() for side in (window[0], window[-1], window[:, 0], window[:, -1])]
        if max(bare) == 0:
            return slice(top, bottom), slice(left, right)
        worst = int(np.argmax(bare))
        top, bottom, left, right = top + (worst == 0), bottom - (worst == 1), left + (worst == 2), right - (worst == 3)
    return slice(0, height), slice(0, width)
