"""Which photos are held out for scoring: the data set's own split, every N-th, those of a list, or none.

Duplicates (`gsjax.io.duplicate_photos`) are held out, or trained on, together.
"""

import difflib
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from gsjax.errors import InputError
from gsjax.io.duplicate_photos import group_duplicates
from gsjax.io.files import read_bytes
from gsjax.io.messages import first_names, print_once
from gsjax.io.photos import Photo

AUTO, NONE = "auto", "none"
EVERY = 8
HINTS = {"absent": "; hold_out takes a number, none, or a file", "empty": "; hold_out=none holds none out"}
OWN_LIST = "hold_out.txt"  # In a data set's folder: its own split.


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
