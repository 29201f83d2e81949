"""Measure between two pixels, and convert a scene or a run to metres by a known length.

Takes what two photos show at two pixels, as the triangulated points of a scene or the
rendered depth of a run have it, and prints the distance. With --is, lengths are in metres
from then on: a scene is also turned upright by its cameras (SCENE/place.json, no other file
changes), the files of a run are written anew. Without --is nothing is changed.

Example: gsjax scale scenes/garden --between 0001.jpg 310 722 0001.jpg 840 715 --is 1.25m
"""

import argparse
from typing import Any

from gsjax.cli.parsers import Command, finite, metres


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("source", metavar="SCENE_OR_RUN", help="folder of a data set, or that `gsjax train` made")
    add("--between", nargs=6, metavar=("PHOTO", "X", "Y", "PHOTO", "X", "Y"), required=True, help="two pixels: a"
        " photo, and a pixel in it from its corner")  # fmt: skip
    add("--is", dest="metres", type=metres, metavar="LENGTH", help="their real distance: 1.25m, 80cm, 12mm, 3ft, 5in")


def run(source: str, between: list[str], metres: float | None = None) -> dict[str, Any]:
    """Measure, and rescale where the length is given."""
    from gsjax import pipeline
    from gsjax.errors import InputError
    from gsjax.runs.pixel_to_point import Pixel

    pixels = []
    for photo, x, y in (between[:3], between[3:]):
        try:
            pixels.append(Pixel(photo, finite(x), finite(y)))
        except argparse.ArgumentTypeError:
            raise InputError(f"--between: {photo} {x} {y} is not a photo and a pixel") from None
    return pipeline.scale(source, pixels, metres)
