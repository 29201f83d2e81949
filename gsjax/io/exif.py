"""EXIF of photos, also where it is damaged: Pillow returns what it can read, or nothing, without an error."""

import re
from typing import Any

from PIL import Image

DETAILS, INTEROPERABILITY = 0x8769, 0xA005  # tables of tags within EXIF
_ORIENTATION, _COLOR_SPACE, _INDEX = 0x0112, 0xA001, 0x0001
_ADOBE_RGB = 2  # of _COLOR_SPACE: no standard, but some cameras write it
# The tag of the orientation as EXIF stores it: one number of two bytes; big-endian, or little-endian.
_STORED = re.compile(rb"\x01\x12\0\x03\0{3}\x01\0([\1-\x08])|\x12\x01\x03\0\x01\0{3}([\1-\x08])\0")


def tags_of(picture) -> Any:
    """Pillow's `Exif` of an opened picture; an empty one where its EXIF cannot be read."""
    try:
        return picture.getexif()
    except Exception:  # Pillow's many ways to say "damaged".
        return Image.Exif()


def table_of(tags, number: int) -> dict[int, Any]:
    """A table of tags within EXIF; an empty one where it is absent or damaged."""
    try:
        return dict(tags.get_ifd(number))
    except Exception:  # As above.
        return {}


def orientation_of(picture) -> int | None:
    """The EXIF orientation of an opened picture, 1 to 8, and 1 where it states none; None where its EXIF is damaged.

    Of damaged EXIF the tag alone is searched: offsets may be wrong while the tag is whole.
    """
    tags = tags_of(picture)
    stated = tags.get(_ORIENTATION, 1 if len(tags) else None)
    if stated in range(1, 9):
        return stated
    stored = picture.info.get("exif")
    if not stored:
        return 1
    tag = _STORED.search(stored)
    return (tag[1] or tag[2])[0] if tag else None


def is_adobe_rgb(picture) -> bool:
    """Whether EXIF says that the colours are Adobe RGB (1998): the index R03 of DCF, or a colour space of 2."""
    tags = tags_of(picture)
    index = str(table_of(tags, INTEROPERABILITY).get(_INDEX, "")).strip("\0 ")
    return index == "R03" or table_of(tags, DETAILS).get(_COLOR_SPACE) == _ADOBE_RGB
