"""Images off the disk and onto it, whole or not at all, and filters that respect straight colours."""

import warnings
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.files import atomic_path
from gsjax.io.packages import require

cv2 = require("cv2", "pip install opencv-contrib-python-headless")
Image = require("PIL.Image", "pip install pillow")

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp", ".heic", ".heif", ".hif", ".avif")  # Of photos.
_ORIENTATION, _QUARTER_TURNS = 0x0112, (5, 6, 7, 8)  # EXIF: the tag, and its values that swap the sides.


def read_image(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """A photo as its pixels are stored: an EXIF orientation is not applied, as COLMAP does not apply it.

    Decoded by Pillow, which refuses a truncated file where OpenCV fills the rest with grey.

    Returns:
        `[H, W, 3]` uint8 colours and `[H, W]` uint8 alpha, or None where the file has no alpha.

    Raises:
        InputError: The file is missing, no image, or damaged.
    """
    picture = _decode(path)
    if picture.mode.startswith("I"):
        grey = (np.asarray(picture, np.float64) / 257.0).round().astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=-1), None
    if picture.mode not in ("RGBA", "LA", "PA") and "transparency" not in picture.info:
        return np.array(picture.convert("RGB")), None
    pixels = np.array(picture.convert("RGBA"))
    return pixels[..., :3], pixels[..., 3]


def read_mask(path: Path) -> np.ndarray:
    """`[H, W]` uint8 mask, 255 where the mask is on; files that count 0/1 instead of 0/255 are understood.

    A file with an alpha channel that is not constant gives its alpha.

    Raises:
        InputError: The file is missing, no image, or damaged.
    """
    colors, alpha = read_image(path)
    mask = colors.max(axis=-1) if alpha is None or alpha.min() == alpha.max() else alpha
    return mask * np.uint8(255) if mask.max() == 1 else mask


def write_image(path: str | Path, image: np.ndarray) -> None:
    """Writes `[H, W, 3]` (or `[H, W]`, `[H, W, 4]`) uint8 pixels, in the format that the suffix names; JPEGs at 95.

    Raises:
        InputError: The target cannot be written.
    """
    with atomic_path(path) as temporary:
        Image.fromarray(np.ascontiguousarray(image)).save(temporary, quality=95)


def jpeg(image: np.ndarray) -> bytes:
    """`[H, W, 3]` uint8 pixels as a JPEG for the screen, at 85."""
    stream = BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(stream, "JPEG", quality=85)
    return stream.getvalue()


def image_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels, from the header only.

    Raises:
        InputError: The file is missing or no image.
    """
    try:
        with Image.open(path) as picture:
            return picture.size
    except (OSError, ValueError, SyntaxError) as error:
        raise _unreadable(path, error) from error


def upright_size(path: Path) -> tuple[int, int]:
    """Width and height of the picture as its EXIF orientation shows it, from the header only.

    Raises:
        InputError: The file is missing or no image.
    """
    try:
        with Image.open(path) as picture:
            width, height = picture.size
            return (height, width) if picture.getexif().get(_ORIENTATION) in _QUARTER_TURNS else (width, height)
    except (OSError, ValueError, SyntaxError) as error:
        raise _unreadable(path, error) from error


def same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether one size (width, height) can be the other resized: some factor gives both sides of the smaller one.

    Programs that resize round a side down, up or to the nearest whole pixel: each side of the smaller one must be less
    than a pixel from the factor times the larger one's.
    """
    (width, height), (full_width, full_height) = sorted((size, other), key=lambda sides: sides[0] * sides[1])
    # The factors that suit a side lie between (side - 1) / full and (side + 1) / full; the two ranges must meet.
    return (width - 1) * full_height < (height + 1) * full_width and (
        (height - 1) * full_width < (width + 1) * full_height
    )


def resize(array: np.ndarray, width: int, height: int) -> np.ndarray:
    """`array` (`[H, W]` or `[H, W, C]`, uint8 or float32) averaged down to `height` x `width`."""
    if array.shape[:2] == (height, width):
        return array
    return cv2.resize(array, (width, height), interpolation=cv2.INTER_AREA)


def resampled(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """`image` (`[H, W]` or `[H, W, C]`, uint8 or float32) at any size: averaged where it shrinks, else bilinear."""
    if width <= image.shape[1] and height <= image.shape[0]:
        return resize(image, width, height)
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)


def filter_straight(
    colors: np.ndarray, alpha: np.ndarray | None, warp: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray | None]:
    """Sends straight colours and their alpha through a filter that mixes pixels.

    Colours are weighted by alpha meanwhile, so what a transparent pixel happens to hold never bleeds in.

    Args:
        colors: `[H, W, 3]` uint8.
        alpha: `[H, W]` uint8 or None.
        warp: Linear filter of `[H, W]` or `[H, W, C]` arrays, uint8 and float32.

    Returns:
        Filtered colours and alpha, uint8.
    """
    if alpha is None:
        return warp(colors), None
    coverage = alpha.astype(np.float32) / np.float32(255)
    filtered = warp(coverage)
    weighted = warp(colors.astype(np.float32) * coverage[..., None])
    straight = weighted / np.maximum(filtered, 1e-6)[..., None]
    return _to_bytes(straight), _to_bytes(255 * filtered)


def _decode(path: Path):
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of large photos; they are what we are here for.
            with Image.open(path) as picture:
                picture.load()
                return picture
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: Exception) -> InputError:
    if isinstance(error, FileNotFoundError):
        return InputError(f"{path}: no such image")
    return InputError(f"{path}: not a whole image ({str(error).splitlines()[0]})")


def _to_bytes(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
