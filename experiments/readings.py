"""Depth of finished runs, read in every way: how far it and its normals are from the truth in held-out views.

    python experiments/readings.py RUN ... [--readings plane front]

needs data sets with true depth or true normals. `gsjax.render.DepthReading` says what the readings are.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from gsjax import tables
from gsjax.cli import guarded
from gsjax.errors import InputError
from gsjax.pipeline.evaluate import score_surface
from gsjax.pipeline.result import open_result, scene_of_run
from gsjax.render import DepthReading

READINGS: tuple[DepthReading, ...] = get_args(DepthReading)
FIGURES = ("depth_error", "normal_error_deg", "normal_error_all_deg")


def compare(folders: Sequence[str], readings: Sequence[DepthReading]) -> dict[str, dict[str, float]]:
    """`FIGURES` of every run by every reading, as far as its truth knows them."""
    figures = {}
    for folder in folders:
        scene, gaussians = scene_of_run(Path(folder)), open_result(folder).gaussians
        for reading in readings:
            found = {} if scene.truth is None else score_surface(gaussians, scene.held_out_frames, scene.truth, reading)
            if not found:
                raise InputError(f"{scene.root}: has neither true depth nor true normals of held-out views")
            figures[f"{folder}, {reading}"] = {name: found[name] for name in FIGURES if name in found}
    return figures


def main() -> None:
    """Reads the arguments and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", metavar="RUN", nargs="+", help="run folders")
    parser.add_argument("--readings", nargs="+", choices=READINGS, default=READINGS, help="(default: all)")
    arguments = parser.parse_args()
    print(tables.compare(compare(arguments.runs, arguments.readings)))


if __name__ == "__main__":
    sys.exit(guarded(main))
