"""The image circle of a fisheye lens, beyond which its photos are black and say nothing."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gsjax.io.images import read_image
from gsjax.io.lenses import Lens, is_circular, principal_point
from gsjax.io.photos import Photo

LOOKED_AT = 3  # photos of a lens
BLACK = 16  # of 255, at most, in every channel
LIT, STRAY = 0.02, 3  # of a ring's pixels, and how many more: so many are not black where there is a picture
RINGS = 400  # from the principal point to the farthest corner
CORNER = 0.95  # of that: a picture that goes farther is no circle
MARGIN = 1.5  # pixels: at its rim the circle is mixed with black
LEAST = 0.25  # of the shorter side: a smaller circle is no lens's, and all is dark


def with_image_circles(photos: Sequence[Photo]) -> list[Photo]:
    """The photos, of those of circular fisheyes with lenses that know how far their picture goes.

    A few photos of each such lens are read.
    """
    circular = {lens for lens in {photo.lens for photo in photos} if is_circular(lens)}
    measured_lenses = {lens: replace(lens, reach=_reach(lens, photos)) for lens in circular}
    return [replace(photo, lens=measured_lenses.get(photo.lens, photo.lens)) for photo in photos]


def _reach(lens: Lens, photos: Sequence[Photo]) -> float:
    """As `Lens.reach`: to the outermost ring that is not black in one of the photos; infinite where all are dark."""
    own = [photo for photo in photos if photo.lens == lens]
    spread = {round(index) for index in np.linspace(0, len(own) - 1, LOOKED_AT)}
    reach = max(_lit_reach(lens, read_image(own[index].path)[0]) for index in spread)
    return reach if reach * lens.width > LEAST * min(lens.width, lens.height) else math.inf


def _lit_reach(lens: Lens, colors: np.ndarray) -> float:
    """Of a photo's width, how far from the principal point it is not black; infinite where it is not at its corners."""
    height, width = colors.shape[:2]
    x, y = principal_point(lens) * [width / lens.width, height / lens.height]
    radii = np.hypot(np.arange(width) + 0.5 - x, (np.arange(height) + 0.5 - y)[:, None])
    rings = (radii / radii.max() * (RINGS - 1)).astype(int)
    pixels, lit = (np.bincount(rings.ravel(), weights, RINGS) for weights in (None, (colors > BLACK).any(-1).ravel()))
    outermost = np.flatnonzero(lit > LIT * pixels + STRAY).max(initial=0)
    share = outermost / (RINGS - 1)
    return math.inf if share > CORNER else (share * radii.max() - MARGIN) / width
