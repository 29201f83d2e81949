"""Posed photos as a data set lists them, and the frames made of them: masked, undistorted, downscaled."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gsjax.errors import InputError
from gsjax.io.bad_items import Fault, leave_out
from gsjax.io.files import stamp
from gsjax.io.images import (
    check_image,
    cv2,
    filter_straight,
    image_size,
    read_image,
    read_mask,
    resize,
    same_shape,
    upright_size,
)
from gsjax.io.lenses import Lens, PinholeView, pinhole_views, resize_lens
from gsjax.io.parallel_map import parallel_map
from gsjax.scene import DepthFile, Frame, Origin, Pixels, Tracks

MASK_USES = ("valid", "matte")


@dataclass(frozen=True)
class Photo:
    """One posed photo, not yet read."""

    name: str  # relative to the image folder
    path: Path
    viewmat: np.ndarray  # [4, 4] float64 rigid, world to camera, OpenCV axes
    lens: Lens
    mask_path: Path | None = None
    held_out: bool = False
    depth: DepthFile | None = None


@dataclass(frozen=True)
class Capture:
    """What a data set's files say, whatever their layout: photos and sparse points."""

    source: str  # "colmap", "transforms" or "nerf-synthetic"
    photos: tuple[Photo, ...]
    points: np.ndarray  # [P, 3] float64 world
    point_colors: np.ndarray  # [P, 3] uint8
    tracks: Callable[[], Tracks] | None = None  # reads them, see `gsjax.scene.Tracks`


def readable_photos(photos: Sequence[Photo]) -> list[Photo]:
    """The photos whose files, and whose masks, are whole (`gsjax.io.bad_items`). All are decoded, once in a process."""
    checked = parallel_map(_fault, photos)
    faults = list(tqdm(checked, total=len(photos), desc="checking", unit="photo", leave=False, delay=2))
    leave_out("photos", [fault for fault in faults if fault], len(photos))
    return [photo for photo, fault in zip(photos, faults, strict=True) if not fault]


def _fault(photo: Photo) -> Fault | None:
    """Why a photo or its mask cannot be decoded; None where both can."""
    for path in (photo.path, photo.mask_path):
        if path is not None and (reason := _decoding_fault(path, stamp(path))):
            return Fault(photo.name, reason)


@lru_cache(maxsize=2**16)
def _decoding_fault(path: Path, _stamp: tuple[int, int]) -> str | None:
    """Why the file of an image, as it was written at a time, cannot be decoded; None where it can."""
    try:
        check_image(path)
    except InputError as error:
        return str(error)


def frames_of(photo: Photo, downscale: float, folder_masks: str) -> list[Frame]:
    """The frames of a photo: one, or six of a panorama. Only headers of files are read.

    Args:
        photo: Where it is, and its camera; the file may be a resized copy of what the camera took.
        downscale: Factor >= 1 by which the frame is smaller than the photo; sides are rounded to whole pixels and K
            is scaled per axis by what the rounding gave.
        folder_masks: "valid" or "matte": what the photo's mask file means.

    Raises:
        InputError: The image is missing or not of its camera's shape. Reading a frame's pixels raises it where the
            image or mask is damaged.
    """
    photo = replace(photo, lens=_lens_of_file(photo))
    if photo.mask_path is not None:
        (width, height), lens = image_size(photo.mask_path), photo.lens
        if not same_shape((width, height), (lens.width, lens.height)):
            raise InputError(f"{photo.mask_path}: mask is {width}x{height} but its image {lens.width}x{lens.height}")
    try:
        views = pinhole_views(photo.lens)
    except InputError as error:
        raise InputError(f"{photo.path}: {error}") from None
    return [_frame(photo, index, downscale, folder_masks) for index in range(len(views))]


def _lens_of_file(photo: Photo) -> Lens:
    """The photo's lens at the size of its file."""
    lens, size = photo.lens, image_size(photo.path)
    camera = (lens.width, lens.height)
    if size == camera:
        return lens
    if same_shape(size, camera):
        return resize_lens(lens, *size)
    turned = upright_size(photo.path)
    if turned != size and same_shape(turned, camera):
        raise InputError(
            f"{photo.path}: image is stored as {size[0]}x{size[1]} and its EXIF orientation turns it, but its camera "
            f"says {camera[0]}x{camera[1]}: the model was made from turned photos; save them turned, and load again"
        )
    raise InputError(f"{photo.path}: image is {size[0]}x{size[1]} but its camera says {camera[0]}x{camera[1]}")


def _frame(photo: Photo, index: int, downscale: float, folder_masks: str) -> Frame:
    view = pinhole_views(photo.lens)[index]
    width, height = scaled_size(view.width, view.height, downscale)
    turn = np.eye(4)
    turn[:3, :3] = view.rotation
    scale = np.array([[width / view.width], [height / view.height], [1.0]])
    lens, origin = photo.lens, None
    if view.source_xy is not None and not view.suffix:
        positions = partial(_positions, lens, (width, height))
        origin = Origin((lens.width, lens.height), (view.width, view.height), positions)
    stem, ending = os.path.splitext(photo.name)
    return Frame(
        name=f"{stem}{view.suffix}{ending}",
        viewmat=(turn @ photo.viewmat).astype(np.float32),
        K=(view.K * scale).astype(np.float32),
        width=width,
        height=height,
        pixels=partial(_read, photo, index, (width, height), folder_masks),
        held_out=photo.held_out,
        origin=origin,
        depth=None if view.suffix else photo.depth,
        masked=view.valid is not None or (photo.mask_path is not None and folder_masks == "valid"),
    )


def _positions(lens: Lens, size: tuple[int, int]) -> np.ndarray:
    """`[H, W, 2]` float32 shares of the photo's width and height at a frame's pixel centres, -1 beyond the photo."""
    (view,) = pinhole_views(lens)
    assert view.source_xy is not None, "only frames of distorted photos have an origin"
    shares = resize(view.source_xy / np.array([lens.width, lens.height], np.float32), *size)
    if view.valid is None:
        return shares
    inside = resize(view.valid.astype(np.float32), *size) > 254.5
    return np.where(inside[..., None], shares, np.float32(-1))


def _read(photo: Photo, index: int, size: tuple[int, int], folder_masks: str) -> Pixels:
    """Decodes a photo and makes the pixels of one of its frames: masked, undistorted, downscaled to `size`."""
    (width, height), lens = size, photo.lens
    view = pinhole_views(lens)[index]
    colors, alpha = read_image(photo.path)
    alpha = None if alpha is None or says_nothing(alpha) else alpha
    mask = None if photo.mask_path is None else _mask_of_size(photo.mask_path, lens.width, lens.height)
    if mask is not None and folder_masks == "matte":
        alpha, mask = mask if alpha is None else np.minimum(alpha, mask), None

    def warp(array: np.ndarray) -> np.ndarray:
        return resize(view.warp(array), width, height)

    unchanged = view.source_xy is None and size == (view.width, view.height)
    image, matte = (colors, alpha) if unchanged else filter_straight(colors, alpha, warp)
    return Pixels(image, matte, valid_of(view, mask, width, height))


def says_nothing(alpha: np.ndarray) -> bool:
    """Whether an alpha channel is one value: no matte then. One of zeros is: the object is not in this view."""
    return bool(alpha.min() == alpha.max() > 0)


def scaled_size(width: int, height: int, downscale: float) -> tuple[int, int]:
    """Width and height of a downscaled image, whole pixels, at least 1."""
    return max(1, round(width / downscale)), max(1, round(height / downscale))


def valid_of(view: PinholeView, mask: np.ndarray | None, width: int, height: int) -> np.ndarray | None:
    """255 where every photo pixel that a frame's pixel draws from may be used, 0 elsewhere, None for all."""
    if mask is None and view.valid is None:
        return None
    usable = np.full((view.height, view.width), 255, np.float32)
    if mask is not None:
        usable = view.warp(np.where(mask >= 128, np.float32(255), np.float32(0)))
    if view.valid is not None:
        usable = np.minimum(usable, view.valid.astype(np.float32))
    return np.where(resize(usable, width, height) > 254.5, np.uint8(255), np.uint8(0))


def _mask_of_size(path: Path, width: int, height: int) -> np.ndarray:
    mask = read_mask(path)
    if mask.shape[1] < width:
        return cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST)
    return resize(mask, width, height)
