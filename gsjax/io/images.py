"""Images off the disk and onto it, whole or not at all, and filters that respect straight colours."""

import os
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gsjax.errors import InputError
from gsjax.io.color_profiles import in_mode, in_srgb
from gsjax.io.exif import orientation_of
from gsjax.io.files import atomic_path
from gsjax.io.machine import memory_for
from gsjax.io.messages import print_first
from gsjax.io.packages import DeferredModule, require

cv2: Any = DeferredModule("cv2")

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp", ".heic", ".heif", ".hif", ".avif")  # Of photos.
_QUARTER_TURNS = 5, 6, 7, 8  # EXIF orientations that swap the sides
_JPEGS = "JPEG", "MPO"  # as Pillow calls them
_JPEG_END = b"\xff\xd9"
_TAIL = 4096  # bytes, more than the last rows of blocks take
_SMALLEST = 8, 8  # pixels: a JPEG is decoded at an eighth of its size where its pixels are not wanted
_JPEG_QUALITY = 95
_LONGEST_SIDE = 1_000_000  # pixels: Pillow fails on far longer ones, which only a damaged header has
_LABELS = 32  # A mask that is darker tells things apart by number.
_OPENING = threading.Lock()
_DECODED, _DECODED_DEEP = 14, 40  # bytes a pixel, most at a time: Pillow's copies, at four each, and ours
_WITH_MATTE = 24  # the same of a photo with alpha until it is reduced: weighted colours are floats
_CONVERTED = 4  # more where a profile makes a copy of the colours
_ALWAYS_ROOM = 10**7  # pixels
_OF_12_BITS = 4095  # What counts to more than a byte and no farther would be almost black as 16 bits.


def read_image(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """A photo as its pixels are stored: an EXIF orientation is not applied, as COLMAP does not apply it.

    Decoded by Pillow, which refuses a truncated file where OpenCV fills the rest with grey. What counts to more than
    255 is taken as 16 bits; floats as shares of 1. Colours are converted to sRGB (`gsjax.io.color_profiles`). A JPEG
    that lacks nothing but its end marker is read.

    Returns:
        `[H, W, 3]` uint8 colours in sRGB and `[H, W]` uint8 alpha, or None where the file has no alpha.

    Raises:
        InputError: The file is missing, no image, or damaged; its pixels are of no known range, or more than memory
            has room for.
    """
    return _pixels(path, partial(in_srgb, path))


def check_image(path: Path) -> None:
    """Raises InputError as `read_image` does; a whole JPEG is decoded at an eighth of its size only."""
    with open_image(path) as picture:
        if picture.format in _JPEGS:
            picture.draft(None, _SMALLEST)
            with suppress(OSError):
                picture.load()
                return
    read_image(path)


def read_mask(path: Path) -> np.ndarray:
    """`[H, W]` uint8 mask, 255 where the mask is on; InputError as of `read_image`.

    Of a file of numbers below 32 (0 and 1, or labels), what is not 0 is on. A file with an alpha channel that is not
    constant gives its alpha.
    """
    colors, alpha = _pixels(path, partial(in_mode, mode="RGB"))  # Numbers, which no profile changes.
    mask = colors.max(axis=-1) if alpha is None or alpha.min() == alpha.max() else alpha
    return np.where(mask > 0, np.uint8(255), np.uint8(0)) if mask.max() < _LABELS else mask


def write_image(path: str | Path, image: np.ndarray) -> None:
    """Writes `[H, W, 3]` (or `[H, W]`, `[H, W, 4]`) uint8 pixels, in the format that the suffix names; JPEGs at 95.

    Raises:
        InputError: The target cannot be written, or its suffix names no format.
    """
    encoded = _encoded(image, _format(Path(path)), quality=_JPEG_QUALITY)  # Pillow does not report a full disk.
    with atomic_path(path) as temporary:
        temporary.write_bytes(encoded)


def jpeg_bytes(image: np.ndarray) -> bytes:
    """`[H, W, 3]` uint8 pixels as a JPEG for the screen, at 85."""
    return _encoded(image, "JPEG", quality=85)


def lossless_webp(image: np.ndarray) -> bytes:
    """`[H, W, 3]` or `[H, W, 4]` uint8 pixels as a WebP that keeps every byte, under an alpha of 0 too."""
    return _encoded(image, "WEBP", lossless=True, exact=True)


def _encoded(image: np.ndarray, form: str, **options: Any) -> bytes:
    stream = BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(stream, form, **options)
    return stream.getvalue()


def decode_rgba(where: str, content: bytes, *, most: int) -> np.ndarray:
    """`[H, W, 4]` uint8 pixels of a WebP or PNG in memory, which `where` names in messages.

    Raises:
        InputError: It is no such image, is damaged, or has more than `most` pixels.
    """
    with warnings.catch_warnings(), decoding(where):
        warnings.simplefilter("ignore")
        with Image.open(BytesIO(content), formats=("WEBP", "PNG")) as picture:
            width, height = picture.size
            if width * height > most:
                raise InputError(f"{where}: {width}x{height} pixels, more than the {most} that it could need")
            return np.array(in_mode(picture, "RGBA"))


def image_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels, from the header only."""
    with open_image(path) as picture:
        return picture.size


def upright_size(path: Path) -> tuple[int, int]:
    """Width and height of the picture as its EXIF orientation shows it, from the header only."""
    with open_image(path) as picture:
        width, height = picture.size
        return (height, width) if orientation_of(picture) in _QUARTER_TURNS else (width, height)


@contextmanager
def open_image(path: str | Path) -> Iterator[Any]:
    """The file as Pillow opens it, of which only the header is read; InputError where it is missing or no image."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Of metadata that nobody asked for.
        with decoding(path):
            picture = _open(Path(path))
        with picture:
            if max(picture.size) > _LONGEST_SIDE:
                width, height = picture.size
                raise InputError(f"{path}: {width}x{height} pixels by its header, which is damaged")
            yield picture


@contextmanager
def decoding(path: str | Path) -> Iterator[None]:
    """A block in which Pillow alone works on a file: whatever it raises but MemoryError becomes an InputError."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:  # Pillow's decoders raise whatever the broken bytes lead to.
        raise _unreadable(Path(path), error) from error


def same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether one size (width, height) can be the other resized, each side rounded down, up or to the nearest pixel."""
    (width, height), (full_width, full_height) = sorted((size, other), key=lambda sides: sides[0] * sides[1])
    # The factors that suit a side are between (side - 1) / full and (side + 1) / full; the two ranges must meet.
    return (width - 1) * full_height < (height + 1) * full_width and (
        (height - 1) * full_width < (width + 1) * full_height
    )


def resize(array: np.ndarray, width: int, height: int) -> np.ndarray:
    """`array` (`[H, W]` or `[H, W, C]`, uint8 or float32) averaged down to `height` x `width`."""
    if array.shape[:2] == (height, width):
        return array
    return cv2.resize(array, (width, height), interpolation=cv2.INTER_AREA)


def resample(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """`image` (`[H, W]` or `[H, W, C]`, uint8 or float32) at any size: averaged where it shrinks, else bilinear."""
    if width <= image.shape[1] and height <= image.shape[0]:
        return resize(image, width, height)
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)


def filter_straight(
    colors: np.ndarray, alpha: np.ndarray | None, warp: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray | None]:
    """Straight colours and their alpha, uint8, after a filter that mixes pixels.

    Colours are weighted by alpha meanwhile, so what a transparent pixel happens to hold never bleeds in.

    Args:
        colors: `[H, W, 3]` uint8.
        alpha: `[H, W]` uint8 or None.
        warp: Linear filter of `[H, W]` or `[H, W, C]` arrays, uint8 and float32.
    """
    if alpha is None:
        return warp(colors), None
    coverage, weighted = alpha.astype(np.float32), colors.astype(np.float32)
    coverage /= 255  # In place, as the next line: a photo may have hundreds of megapixels.
    weighted *= coverage[..., None]
    filtered = warp(coverage)
    straight = warp(weighted) / np.maximum(filtered, 1e-6)[..., None]
    return _to_bytes(straight), _to_bytes(255 * filtered)


def _pixels(path: Path, rgb_of: Callable[[Any], Any]) -> tuple[np.ndarray, np.ndarray | None]:
    """Colours and alpha as of `read_image`; `rgb_of` converts a decoded picture of any mode to mode RGB."""
    with _decoded(path) as picture:
        if _is_deep(picture):
            grey = Image.fromarray(_in_bytes(path, picture))
            grey.info = picture.info
            return np.array(rgb_of(grey)), None
        alpha = np.array(in_mode(picture, "RGBA").getchannel("A")) if _has_alpha(picture) else None
        return np.array(rgb_of(picture)), alpha


@contextmanager
def _decoded(path: Path) -> Iterator[Any]:
    """The picture with its pixels, while memory is kept for what becomes of it in the block."""
    with ExitStack() as stack:
        picture = stack.enter_context(open_image(path))
        width, height = picture.size
        if width * height > _ALWAYS_ROOM:
            a_pixel = _DECODED_DEEP if _is_deep(picture) else _WITH_MATTE if _has_alpha(picture) else _DECODED
            a_pixel += _CONVERTED * bool(picture.info.get("icc_profile"))
            stack.enter_context(memory_for(f"{path}: a photo of {width}x{height} pixels", a_pixel * width * height))
        is_of_16_bits = not _is_deep(picture) and ";16" in str(picture.tile)
        picture = _load_pixels(path, picture)
        if is_of_16_bits:
            _check_bright(path, picture)
        yield picture


def _load_pixels(path: Path, picture):
    """The picture with its pixels, or InputError where it is damaged."""
    with decoding(path):
        try:
            picture.load()
        except OSError:
            whole = _without_end_marker(path) if picture.format in _JPEGS else None
            if whole is None:
                raise
            message = f"{path}: its end marker is missing, its pixels are all there; it is read"
            print_first((path.parent, "end marker"), message)
            return whole
    if picture.mode == "LAB":
        raise InputError(f"{path}: its colours are in Lab, which is not read; save it in RGB")
    return picture


def _without_end_marker(path: Path):
    """The picture of a JPEG whose pixels are all there, though its end is not; None where pixels are missing.

    Bits that are missing would be taken from what follows: with other bytes behind it, the picture would be another.
    """
    data = path.read_bytes().rstrip(b"\xff")  # half of the marker may be there
    first, second = (Image.open(BytesIO(data + tail * _TAIL + _JPEG_END)) for tail in (b"\x55", b"\xaa"))
    return first if np.array_equal(np.asarray(first), np.asarray(second)) else None


def _open(path: Path):
    with path.open("rb") as file:
        head = file.read(12)
    if head[4:8] == b"ftyp" and head[8:12] != b"avif":  # HEIC, whatever the name says: what an iPhone takes.
        require("pillow_heif").register_heif_opener()
    with _OPENING:
        limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
        try:
            return Image.open(path)
        finally:
            Image.MAX_IMAGE_PIXELS = limit


def _is_deep(picture) -> bool:
    """Whether a picture is of one channel that counts to more than 255, or of floats."""
    return picture.mode.startswith("I") or picture.mode == "F"


def _check_bright(path: Path, picture) -> None:
    """InputError where a picture leaves the upper bits of its 16 a channel unused: Pillow keeps only those."""
    most = {band: high for band, (_, high) in zip(picture.getbands(), picture.getextrema(), strict=True)}
    shows_something = most.pop("A", 255) > 0
    if shows_something and max(most.values()) <= _OF_12_BITS >> 8:
        raise _dark(path, 256 * max(most.values()) + 255)


def _dark(path: Path, most: float) -> InputError:
    return InputError(
        f"{path}: has 16 bits, and its brightest pixel only {most:g} of 65535, almost black; save it with 8 bits, or"
        " with values to 65535"
    )


def _has_alpha(picture) -> bool:
    return picture.mode in ("RGBA", "LA", "PA") or "transparency" in picture.info


def _in_bytes(path: Path, picture) -> np.ndarray:
    """`[H, W]` uint8 of a picture of one channel that is not of bytes: of shares of 1, bytes after all, or 16 bits."""
    with np.errstate(invalid="ignore"):  # Of NaNs that signal; all are looked for below.
        values = np.asarray(picture, np.float64)
    least, largest = float(values.min()), float(values.max())
    whole = bool(np.isfinite(values).all()) and not (values % 1).any()
    if least >= 0 and largest <= 1 and picture.mode == "F":
        return _to_bytes(255 * values)
    if least >= 0 and largest <= 255 and whole:
        return _to_bytes(values)
    if least >= 0 and largest <= _OF_12_BITS and whole:
        raise _dark(path, largest)
    if least >= 0 and largest <= 65535 and whole:
        return _to_bytes(values / 257)
    raise InputError(f"{path}: its pixels run from {least:g} to {largest:g}; known are 0 to 1, to 255 and to 65535")


def _format(path: Path) -> str:
    """What Pillow calls the format of a suffix."""
    Image.init()
    formats = Image.registered_extensions()
    if path.suffix.lower() not in formats:
        raise InputError(f"{path}: no format of images ends in {path.suffix or 'nothing'}")
    return formats[path.suffix.lower()]


def _unreadable(path: Path, error: Exception) -> InputError:
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return InputError(f"{path}: no such image")
    if os.path.isfile(path) and not path.stat().st_size:  # Unlike Path, also of a name that is too long.
        return InputError(f"{path}: not a whole image (it is empty)")
    if isinstance(error, Image.UnidentifiedImageError):
        return InputError(
            f"{path}: not a whole image (of no format that is read here; TIFFs of floats have one channel)"
        )
    if isinstance(error, OSError) and error.strerror:
        return InputError(f"{path}: not a whole image ({error.strerror})")
    reason = str(error).splitlines()[0] if str(error) else "it ends too soon"
    return InputError(f"{path}: not a whole image ({reason})")


def _to_bytes(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
