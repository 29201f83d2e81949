"""Similarities in JSON, as `dataclasses.asdict` has them."""

import math
from pathlib import Path
from typing import Any

from gsjax.errors import InputError
from gsjax.similarity import Similarity

LARGEST_SCALE = 2.0**100  # Of both ways, beside which float32 has room for the places themselves.
FARTHEST = 2.0**60  # local units from the world's origin: float64 tells places there no longer apart


def parsed_similarity(kept: Any, file: Path) -> Similarity:
    """The similarity that a file holds.

    Raises:
        InputError: What it holds is none; names the file.
    """
    try:
        x, y, z = (float(number) for number in kept["center"])
        similarity = Similarity(float(kept["scale"]), (x, y, z))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{file}: holds no similarity of a scale and a center ({str(kept)[:80]})") from error
    scale, farthest = similarity.scale, max(map(abs, (x, y, z))) * similarity.scale
    if not (1 / LARGEST_SCALE <= scale <= LARGEST_SCALE and all(map(math.isfinite, (x, y, z))) and farthest < FARTHEST):
        raise InputError(f"{file}: a similarity of scale {scale:g} and center {x:g} {y:g} {z:g} is none")
    return similarity
