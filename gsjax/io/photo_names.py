"""Names of photos as data sets list them, and as they are here: other machines have other paths and other spellings."""

import os
import posixpath
import re
import unicodedata
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath

from gsjax.io.messages import print_once

_AS_JPEG = (".heic", ".heif", ".hif", ".avif", ".webp")  # Of photos that have lost more than a JPEG at 95 loses.
_DRIVE = re.compile(r"[A-Za-z]:/|//")  # Of Windows, once its separators are those of everybody else.


def local_names(listed: Sequence[str], exists: Callable[[str], bool], place: object) -> list[str]:
    """The names under which the photos that a file, `place`, lists are found here, or would be.

    A name that exists stays as it is. Else its backslashes separate folders; and where it is a path of another machine,
    absolute or out of its folder, its last parts name the photo: as many of them as exist, or those in which the
    listed paths differ. A line on stderr says so.
    """
    spelled = [name if exists(name) else name.replace("\\", "/") for name in listed]
    foreign = [n for n in spelled if (n.startswith(("/", "../")) or _DRIVE.match(n)) and not exists(n)]
    if not foreign:
        return spelled
    are_alike = len({name.startswith("/") for name in foreign}) == 1  # Absolute and other names have no common folder.
    shared = posixpath.commonpath([posixpath.dirname(name) for name in foreign]) if are_alike else ""
    ends = {name: _end(name, exists) or _below(name, shared) for name in foreign}
    if len(set(ends.values())) < len(ends):  # Two photos would be one.
        ends = {name: _below(name, shared) for name in foreign}
    print_once(f"images: {place} lists paths of another machine, as {foreign[0]}; it is taken for {ends[foreign[0]]}")
    return [ends.get(name, name) for name in spelled]


def path_inside(name: str) -> PurePosixPath:
    """A name as a path within a folder: parts that would lead out of it are left out."""
    path = PurePosixPath(name)
    return PurePosixPath(*[part for part in path.parts if part not in (path.anchor, "..")])


def written_name(name: str, has_matte: bool) -> str:
    """A photo's name where it is written anew, within a folder: a JPEG stays one, others become PNGs.

    A matte makes a PNG of any. Photos of iPhones and of the web become JPEGs. What no list of names can hold, such as
    the end of a line, becomes an underscore.
    """
    path = path_inside(printable_name(name))
    suffix = path.suffix.lower()
    if suffix in (".jpg", ".jpeg") and not has_matte:
        return str(path)
    return str(path.with_suffix(".jpg" if suffix in _AS_JPEG and not has_matte else ".png"))


def printable_name(name: str) -> str:
    """A name with underscores in place of what is no part of a line: ends of lines, tabs, broken characters."""
    return "".join(character if character.isprintable() else "_" for character in name)


def short_name(name: str) -> str:
    """A name without the folder `images/`, in which photos mostly are, and without detours."""
    name = posixpath.normpath(name)
    return name.removeprefix("images/") or name


def spellings(path: Path) -> list[Path]:
    """The path, and other spellings of what of it does not exist: accents composed or not, bytes of Latin-1."""
    if str(path).isascii():
        return [path]
    there = next((parent for parent in path.parents if os.path.exists(parent)), Path())
    rest = os.path.relpath(path, there)
    forms = [unicodedata.normalize(form, rest) for form in ("NFC", "NFD")]
    with suppress(UnicodeEncodeError):
        forms.append(os.fsdecode(rest.encode("latin-1")))
    return [path, *(there / form for form in forms)]


def _end(name: str, exists: Callable[[str], bool]) -> str | None:
    """The longest end of a path that exists."""
    parts = [part for part in name.split("/") if part not in ("", "..")]
    return next((end for i in range(len(parts)) if exists(end := "/".join(parts[i:]))), None)


def _below(name: str, folder: str) -> str:
    return posixpath.relpath(name, folder) if folder else posixpath.basename(name)
