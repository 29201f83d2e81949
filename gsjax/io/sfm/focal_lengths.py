"""Focal lengths of EXIF, and which of them serve as priors.

The EXIF standard (CIPA DC-008, 4.6.6) has `FocalLength` of the lens, `FocalLengthIn35mmFilm` of a camera of 35 mm film
with the same view (0: unknown), and `DigitalZoomRatio` (numerator 0: not used). It leaves open whether the second
includes the third. In photos of iPhones it does; other makers' are compared with each other.
"""

import math
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

from gsjax.io.sfm.gps import finite_number

FOCAL, FOCAL_35, ZOOM = 0x920A, 0xA405, 0xA404  # tags of EXIF
LEAST, MOST = 8.0, 400.0  # mm of 35 mm film: shorter and longer ones are of no lens that scenes are taken with
FILM_DIAGONAL = 43.27  # mm, of 36 x 24


class Focal(NamedTuple):
    """The focal length in a photo's EXIF."""

    lens: str  # mm, as it is written; equal for photos of one setting
    film_35: float  # mm for 35 mm film; 0: unknown
    zoom: float  # digital zoom; 1: none


CameraKey = tuple[str, str, Focal, int, int]
"""Make, model, focal length, width and height: equal for the photos of one camera."""


def read_focal(details: Mapping[int, Any]) -> Focal:
    """Read the focal length from the table of a photo's details; a damaged value counts as absent."""
    zoom, film = finite_number(details.get(ZOOM)), finite_number(details.get(FOCAL_35))
    return Focal(str(details.get(FOCAL, "")), film if film > 0 else 0.0, round(zoom, 2) if zoom > 0 else 1.0)


def usable_prior(camera: CameraKey, cameras: Collection[CameraKey], guess: float) -> tuple[float | None, str]:
    """Return the focal length in pixels that a camera starts from, or None and the reason why EXIF's is ignored.

    The guess is in pixels, by EXIF without its digital zoom. Whether a maker's 35 mm equivalent includes that zoom, all
    `cameras` of the set show.
    """
    *_, focal, width, height = camera
    if focal.zoom != 1 and not (focal.film_35 and (includes := _includes_zoom(camera, cameras))):
        if focal.film_35 and includes is None:
            return None, f"it does not say whether {focal.film_35:g} mm of 35 mm film includes its zoom {focal.zoom:g}"
        guess *= focal.zoom
    film = guess * FILM_DIAGONAL / math.hypot(width, height)
    if not LEAST <= film <= MOST:
        return None, f"{film:.3g} mm of 35 mm film is not between {LEAST:g} and {MOST:g}"
    return guess, ""


def _includes_zoom(camera: CameraKey, cameras: Collection[CameraKey]) -> bool | None:
    """Decide whether the 35 mm equivalent changes with the digital zoom; None: unknown.

    Of the photos with the same lens and another zoom, those whose zoom differs most decide.
    """
    make, model, focal, *_ = camera
    others = [other[2] for other in cameras if other[:2] == (make, model) and other[2].lens == focal.lens]
    others = [other for other in others if other.film_35 and other.zoom != focal.zoom]
    if not others:
        return True if make.strip("\0 ").casefold() == "apple" else None
    other = max(others, key=lambda other: abs(math.log(other.zoom / focal.zoom)))
    changed, zoomed = math.log(focal.film_35 / other.film_35), math.log(focal.zoom / other.zoom)
    return abs(changed - zoomed) < abs(changed)
