"""Groups of photos that show one shot: a HEIC and its JPEG, a resized or re-encoded file, a second file of one name.

Two files show the same shot where small grey pictures of them are equal but for what encoders, resizing and another
colour space change. Each group is compared with its first photo only, or a slow video would become one group.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from gsjax.io.color_profiles import in_srgb
from gsjax.io.exif import orientation_of
from gsjax.io.files import stamp
from gsjax.io.images import Image, decoding, open_image, read_image
from gsjax.io.machine import memory_for
from gsjax.io.parallel_map import parallel_map

SIDE = 32  # pixels of the small picture
MOST_LEVELS = 1.5  # RMS of 255; measured: JPEG at 50 or a third of the size 0.2 to 1.3, neighbouring views from 2
MOST_SHARE = 0.1  # the same RMS as a share of the picture's own contrast: views of a bare wall differ by few levels
_FLAT = 1.0  # levels of contrast: a picture with less shows nothing to compare
_DRAFT = 256  # pixels of the shorter side, at least, of a reduced picture
_ALWAYS_ROOM, _DECODED = 10**7, 8  # pixels that need no check of the memory; bytes a pixel while one is decoded
_REDUCIBLE = "RGB", "L", "CMYK"  # modes that Pillow averages as they are: no palettes, no alpha, no 16 bits


def group_duplicates(files: Sequence[Path]) -> list[list[int]]:
    """Group files by the shot that they show: lists of indices, in the order of their first files.

    A file that cannot be read, or shows one colour, is a group of its own.
    """
    pictures = list(parallel_map(lambda file: _small_picture(file, stamp(file)), files))
    groups: list[list[int]] = []
    firsts = np.empty((0, SIDE * SIDE), np.float32)  # of those groups in `leaders`, unit vectors
    contrasts, leaders = np.empty(0, np.float32), list[int]()
    for index, picture in enumerate(pictures):
        contrast = 0.0 if picture is None else float(picture.std())
        if picture is None or contrast < _FLAT:
            groups.append([index])
            continue
        unit = picture / np.linalg.norm(picture)
        share = np.sqrt(np.maximum(2 - 2 * (firsts @ unit), 0))  # RMS of the difference, of the contrast
        is_same = (share < MOST_SHARE) & (share * np.sqrt(contrasts * contrast) < MOST_LEVELS)
        if is_same.any():
            groups[leaders[int(np.where(is_same, share, np.inf).argmin())]].append(index)
            continue
        leaders.append(len(groups))
        groups.append([index])
        firsts, contrasts = np.vstack([firsts, unit]), np.append(contrasts, np.float32(contrast))
    return groups


@cache
def _small_picture(file: Path, _stamp: tuple[int, int]) -> np.ndarray | None:
    """`[SIDE * SIDE]` float32 grey levels less their mean, upright; None of a file that cannot be read.

    It is made once for each state of a file: commands load a data set several times.
    """
    try:
        with open_image(file) as picture:
            picture.draft("RGB", (_DRAFT, _DRAFT))
            reduced = _reduced(file, picture) if picture.mode in _REDUCIBLE else Image.fromarray(read_image(file)[0])
            upright = _upright(reduced.convert("L").resize((SIDE, SIDE), Image.Resampling.LANCZOS), picture)
    except (OSError, ValueError):
        return None
    levels = np.asarray(upright, np.float32).reshape(-1)
    return levels - levels.mean()


def _reduced(file: Path, picture):
    """In sRGB, with so few pixels that conversion is quick, and so many that their means hardly depend on the space."""
    pixels = picture.size[0] * picture.size[1]
    needed = _DECODED * pixels * (pixels > _ALWAYS_ROOM)
    with memory_for(f"{file}: a photo of {pixels} pixels", needed), decoding(file):
        reduced = picture.reduce(max(1, min(picture.size) // _DRAFT))
    reduced.format = picture.format  # which Pillow drops, and which tells where code points are
    return in_srgb(file, reduced)


def _upright(small, picture):
    """The small picture, turned as the EXIF orientation of the file says."""
    turn = Image.Transpose
    turns = [turn.FLIP_LEFT_RIGHT, turn.ROTATE_180, turn.FLIP_TOP_BOTTOM]
    turns += [turn.TRANSPOSE, turn.ROTATE_270, turn.TRANSVERSE, turn.ROTATE_90]
    orientation = orientation_of(picture) or 1
    return small if orientation == 1 else small.transpose(turns[orientation - 2])
