"""Similarities in JSON, as `dataclasses.asdict` has them."""

import math
from pathlib import Path
from typing import Any

from gsjax.errors import InputError
from gsjax.similarity import Similarity


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
    if not (similarity.scale > 0 and all(map(math.isfinite, (similarity.scale, x, y, z)))):
        raise InputError(f"{file}: a similarity of scale {similarity.scale:g} and center {x:g} {y:g} {z:g} is none")
    return similarity
