"""Which photos are held out for scoring: the data set's own split, every N-th, those of a list, or none.

Duplicates show one shot: a HEIC and its JPEG, a resized or re-encoded file, a second file of one name. They are held
out, or trained on, together. Two files show the same shot where small grey pictures of them are equal but for what
encoders, resizing and another colour space change. Each group is compared with its first photo only, or a slow video
would become one group.
"""

import difflib
import os
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from PIL import ExifTags, ImageOps

from gsjax.errors import InputError
from gsjax.io.color_profiles import in_srgb
from gsjax.io.exif import orientation_of
from gsjax.io.files import read_bytes, stamp
from gsjax.io.images import Image, decoding, open_image, read_image
from gsjax.io.machine import memory_for
from gsjax.io.messages import first_names, print_once
from gsjax.io.parallel_map import parallel_map
from gsjax.io.photos import Photo

AUTO, NONE = "auto", "none"
EVERY = 8
HINTS = {"absent": "; hold_out takes a number, none, or a file", "empty": "; hold_out=none holds none out"}
OWN_LIST = "hold_out.txt"  # In a data set's folder: its own split.
SIDE = 32  # pixels of the small picture
MOST_LEVELS = 1.5  # RMS of 255; measured: JPEG at 50 or a third of the size 0.2 to 1.3, neighbouring views from 2
MOST_SHARE = 0.1  # the same RMS as a share of the picture's own contrast: views of a bare wall differ by few levels
_FLAT = 1.0  # levels of contrast: a picture with less shows nothing to compare
_DRAFT = 256  # pixels of the shorter side, at least, of a reduced picture
_ALWAYS_ROOM, _DECODED = 10**7, 8  # pixels that need no check of the memory; bytes a pixel while one is decoded
_REDUCIBLE = "RGB", "L", "CMYK"  # modes that Pillow averages as they are: no palettes, no alpha, no 16 bits


def mark_held_out(photos: Sequence[Photo], hold_out: str, root: Path) -> list[Photo]:
    """Mark the photos that are held out.

    A photo and its duplicates are one group, which is held out or trained on as a whole. If a list or the data set's
    own split names one of them, the others are held out as well, and a line on stderr names them.

    Args:
        photos: Sorted by name.
        hold_out: A number N: every N-th group, starting with the first (of N groups, the first of those with the
            fewest files); "none"; a text file of names, one a line, where blank lines and lines that begin with # are
            ignored; "auto": the layout's own split, else the names in `root`/hold_out.txt, else every 8th.
        root: Folder of the data set.

    Raises:
        InputError: It is none of these, or the file names a photo that there is not, or none.
    """
    if hold_out == NONE:
        return [replace(photo, held_out=False) for photo in photos]
    stated_split = _stated_split(photos, hold_out, root)
    names = [photo.name for photo in photos]
    groups = [[names[index] for index in rows] for rows in group_duplicates([photo.path for photo in photos])]
    if isinstance(stated_split, int):
        stretches = [groups[first : first + stated_split] for first in range(0, len(groups), stated_split)]
        held_out = {name for stretch in stretches for name in min(stretch, key=len)}
    else:
        held_out = _with_copies(stated_split, groups, root)
    return [replace(photo, held_out=photo.name in held_out) for photo in photos]


def _with_copies(names: set[str], groups: Sequence[Sequence[str]], root: Path) -> set[str]:
    """Return the stated names and those of their duplicates."""
    held_out = {name for group in groups if not names.isdisjoint(group) for name in group}
    if copies := sorted(held_out - names):
        reason = "held out as well, as duplicates of held-out photos"
        print_once(f"{root}: {reason}: {first_names(copies)}")
    return held_out


def _stated_split(photos: Sequence[Photo], hold_out: str, root: Path) -> set[str] | int:
    """Return the stated names, or N for every N-th group."""
    names = [photo.name for photo in photos]
    if hold_out == AUTO:
        own = {photo.name for photo in photos if photo.held_out}
        return own or (listed(root / OWN_LIST, names, **HINTS) if (root / OWN_LIST).is_file() else EVERY)
    if not hold_out.isdecimal():
        return listed(Path(hold_out), names, **HINTS)
    if int(hold_out) < 2:
        raise InputError(f"hold_out={hold_out}: every N-th photo needs an N of at least 2")
    return int(hold_out)


def listed(file: Path, names: Sequence[str], *, absent: str = "", empty: str = "") -> set[str]:
    """The names in a text file, one a line, all of which must be among `names`, or InputError is raised.

    Blank lines are ignored, and those that begin with #, unless that is a name. `absent` is the end of the message
    where there is no such file, `empty` where it names no photo.
    """
    if not os.path.lexists(file):
        raise InputError(f"{file}: no such list of photos{absent}")
    try:
        lines = read_bytes(file).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: cannot be read as a list of photos ({error})") from error
    photo_names = set(names)  # A name may begin with what else is a comment, or end in a space.
    named = [line if line in photo_names else line.strip() for line in lines]
    by_line = {n: name for n, name in enumerate(named, 1) if name in photo_names or (name and not name.startswith("#"))}
    if not by_line:
        raise InputError(f"{file}: names no photo{empty}")
    for number, name in by_line.items():
        if name not in photo_names:
            (nearest,) = difflib.get_close_matches(name, names, n=1, cutoff=0.0)
            raise InputError(f"{file}, line {number}: there is no photo {name}; the nearest name is {nearest}")
    return set(by_line.values())


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
            small = reduced.convert("L").resize((SIDE, SIDE), Image.Resampling.LANCZOS)
            small.info.clear()
            small.getexif()[ExifTags.Base.Orientation] = orientation_of(picture) or 1
            upright = ImageOps.exif_transpose(small)
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
