"""Which photos are held out for scoring: the data set's own split, every N-th, those of a list, or none."""

import difflib
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from gsjax.errors import InputError
from gsjax.io.files import read_bytes
from gsjax.io.photos import Photo

AUTO, NONE = "auto", "none"
EVERY = 8
HINTS = {"absent": "; --hold-out takes a number, none, or a file", "empty": "; --hold-out none holds none out"}
OWN_LIST = "hold_out.txt"  # In a data set's folder: its own split.


def mark_held_out(photos: Sequence[Photo], hold_out: str, root: Path) -> list[Photo]:
    """Marks the photos that are held out.

    Args:
        photos: Sorted by name.
        hold_out: A number N: every N-th, starting with the first; "none"; a text file of names, one a line, where
            blank lines and lines that begin with # do not count; "auto": the layout's own split, else the names in
            `root`/hold_out.txt, else every 8th.
        root: Folder of the data set.

    Raises:
        InputError: It is none of these, or the file names a photo that there is not, or none.
    """
    held_out = _held_out(photos, hold_out, root)
    return [replace(photo, held_out=photo.name in held_out) for photo in photos]


def _held_out(photos: Sequence[Photo], hold_out: str, root: Path) -> set[str]:
    names = [photo.name for photo in photos]
    if hold_out == NONE:
        return set()
    if hold_out == AUTO:
        own = {photo.name for photo in photos if photo.held_out}
        return own or (listed(root / OWN_LIST, names, **HINTS) if (root / OWN_LIST).is_file() else set(names[::EVERY]))
    if not hold_out.isdecimal():
        return listed(Path(hold_out), names, **HINTS)
    if int(hold_out) < 2:
        raise InputError(f"--hold-out {hold_out}: every N-th photo needs an N of at least 2")
    return set(names[:: int(hold_out)])


def listed(file: Path, names: Sequence[str], *, absent: str = "", empty: str = "") -> set[str]:
    """The names in a text file, one a line, all of which must be among `names`.

    Blank lines do not count, nor those that begin with #, unless that is a name.

    Args:
        file: The list.
        names: Of all photos.
        absent: What else the option takes, for the message where there is no such file.
        empty: Likewise, where it names no photo.

    Raises:
        InputError: There is no such file, or it names no photo or one that there is not.
    """
    if not os.path.lexists(file):
        raise InputError(f"{file}: no such list of photos{absent}")
    try:
        lines = read_bytes(file).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: cannot be read as a list of photos ({error})") from error
    known = set(names)  # A name may begin with what else is a comment, or end in a space.
    named = [line if line in known else line.strip() for line in lines]
    wanted = {n: name for n, name in enumerate(named, 1) if name in known or (name and not name.startswith("#"))}
    if not wanted:
        raise InputError(f"{file}: names no photo{empty}")
    for number, name in wanted.items():
        if name not in known:
            (nearest,) = difflib.get_close_matches(name, names, n=1, cutoff=0.0)
            raise InputError(f"{file}, line {number}: there is no photo {name}; the nearest name is {nearest}")
    return set(wanted.values())
