"""The GPS position in a photo's EXIF."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

TAG = 0x8825  # of the table of GPS in EXIF
_LATITUDE, _LONGITUDE, _ALTITUDE_SIDE, _ALTITUDE, _STATUS = 2, 4, 5, 6, 9
_FARTHEST = 100_000.0  # metres above or below the sea, beyond which an altitude is an error


class Fix(NamedTuple):
    """A place by GPS, WGS 84."""

    latitude: float  # degrees north
    longitude: float  # degrees east
    altitude: float  # metres above the device's zero; NaN: unknown


def read_fix(tags: Mapping[int, Any]) -> Fix | str | None:
    """Read the position from the table of GPS; return words for its fault, or None where there is none.

    Receivers without a fix write 0, 0 or the status V, which is None. An unreadable altitude is NaN.
    """
    if _LATITUDE not in tags and _LONGITUDE not in tags:
        return None
    if str(tags.get(_STATUS, "A")).strip("\0 ").upper() == "V":
        return None
    angles = []
    for name, tag, sides, limit in (("latitude", _LATITUDE, "NS", 90), ("longitude", _LONGITUDE, "EW", 180)):
        letter, degrees = _letter(tags.get(tag - 1)), _degrees(tags.get(tag))  # The tag of the side comes before.
        if letter not in tuple(sides):
            return f"its {name} does not say {' or '.join(sides)}"
        if not abs(degrees) <= limit:  # Also of no number.
            return f"its {name} is no angle"
        angles.append(degrees if letter == sides[0] else -degrees)
    latitude, longitude = angles
    return Fix(latitude, longitude, _altitude(tags)) if latitude or longitude else None


def _letter(side: Any) -> str:
    text = side.decode("ascii", "replace") if isinstance(side, bytes) else str(side or "")
    return text.strip("\0 ").upper()[:1]


def _degrees(parts: Any) -> float:
    """Convert degrees, minutes and seconds, the last of which may be absent; NaN where they are no angle."""
    try:
        numbers = [finite_number(part) for part in parts]
    except TypeError:
        return math.nan
    if not 1 <= len(numbers) <= 3 or not all(number >= 0 for number in numbers):
        return math.nan
    return sum(number / unit for number, unit in zip(numbers, (1, 60, 3600), strict=False))


def _altitude(tags: Mapping[int, Any]) -> float:
    altitude = finite_number(tags.get(_ALTITUDE))
    if not abs(altitude) < _FARTHEST:
        return math.nan
    side = tags.get(_ALTITUDE_SIDE, b"\0")
    is_below = side in (1, b"\x01", "\x01", "1")
    return -altitude if is_below else altitude


def finite_number(rational: Any) -> float:
    """Convert a number of EXIF; NaN where it is none that is finite, such as a fraction over zero."""
    try:
        number = float(rational)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return math.nan
    return number if math.isfinite(number) else math.nan
