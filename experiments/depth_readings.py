"""How far is the depth of finished runs from the truth, read in every way, and how far its normals, in held-out views?

    python experiments/depth_readings.py RUN ... [--readings plane front] [--picture FILE.png] [--view N]

Needs data sets with true depth or true normals. `gsjax.render.DepthReading` says what the readings are. The picture
shows the first run: a held-out view in its colours, and the normals of every reading.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import numpy as np

from gsjax import tables
from gsjax.cli import run_guarded
from gsjax.errors import InputError

if TYPE_CHECKING:  # They import jax.
    from gsjax.render import DepthReading
    from gsjax.runs.result import Result

FIGURES = ("depth_error", "normal_error_deg", "normal_error_all_deg")


def compare(folders: Sequence[str], readings: Sequence["DepthReading"]) -> dict[str, dict[str, float]]:
    """`FIGURES` of every run by every reading, as far as its truth knows them."""
    from gsjax.runs.result import open_result, scene_of_run
    from gsjax.scoring.surfaces import score_surface

    figures = {}
    for folder in folders:
        scene, gaussians = scene_of_run(Path(folder)), open_result(folder).gaussians
        for reading in readings:
            found = {} if scene.truth is None else score_surface(gaussians, scene.held_out_frames, scene.truth, reading)
            if not found:
                raise InputError(f"{scene.root}: has neither true depth nor true normals of held-out views")
            figures[f"{folder}, {reading}"] = {name: found[name] for name in FIGURES if name in found}
    return figures


def panels(result: "Result", readings: Sequence["DepthReading"], view: int) -> dict[str, np.ndarray]:
    """`[H, W, 3]` uint8 pictures by their titles: one held-out view's colours, and the normals of every reading."""
    from gsjax.colors import to_bytes
    from gsjax.render import gallery
    from gsjax.report.pictures import surface_picture

    held_out = [camera for camera, is_held_out in zip(result.cameras, result.held_out, strict=True) if is_held_out]
    if not 0 <= view < len(held_out):
        raise InputError(f"--view: the run holds out {len(held_out)} views; there is no view {view}")
    camera, found = held_out[view], {}
    for reading in readings:
        picture = next(gallery.pictures(result.gaussians, [camera], result.background, reading))
        found.setdefault("colours", to_bytes(picture.colors))
        found[reading] = surface_picture(picture.depth, camera)
    return found


def main() -> None:
    """Reads the arguments and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", metavar="RUN", nargs="+", help="run folders")
    parser.add_argument("--readings", nargs="+", help="of gsjax.render.DepthReading (default: all)")
    parser.add_argument("--picture", metavar="FILE", help="of the first run (.png)")
    parser.add_argument("--view", type=int, default=0, metavar="N", help="of the held-out ones (default: 0)")
    arguments = parser.parse_args()
    from gsjax.render import DepthReading
    from gsjax.report.panels import draw_panels
    from gsjax.runs.result import open_result

    known: tuple[DepthReading, ...] = get_args(DepthReading)
    readings = arguments.readings or known
    if unknown := [reading for reading in readings if reading not in known]:
        raise InputError(f"--readings: no reading {unknown[0]!r}; there are {', '.join(known)}")
    if arguments.picture is not None:
        shown = panels(open_result(arguments.runs[0]), readings, arguments.view)
        draw_panels(shown, arguments.picture, columns=len(shown))
    print(tables.compare(compare(arguments.runs, readings)))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
