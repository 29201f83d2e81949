"""Which held-out views do runs show better or worse than another run: all of them, or one?

    python experiments/view_by_view.py PLAIN RUN ...

All runs hold out the same photos of one data set. A mean over few views can hang on one that shows what no other photo
does: beside it stand its error and the median of the differences. A photo is compared in the light of those taken near
it, where the run undid exposures.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import mean, median, stdev

from gsjax import tables
from gsjax.cli import run_guarded
from gsjax.errors import InputError

WAYS = "psnr_near_gains", "psnr"  # of scoring a picture, the first that a run knows


def main(plain: str, others: Sequence[str]) -> int:
    """Prints a line a view: dB of the first run, and what the others add to it."""
    first = psnr_by_view(plain)
    columns = {plain: {**first, "mean": mean(first.values()), "median": median(first.values())}}
    columns |= {other: gains(first, psnr_by_view(other), where=other) for other in others}
    lines = (*first, "mean", "error of the mean", "median")
    print(tables.compare({line: {run: column.get(line) for run, column in columns.items()} for line in lines}))
    return 0


def psnr_by_view(run: str) -> dict[str, float]:
    """PSNR in dB of every held-out photo, by its name.

    Raises:
        InputError: The run or its data set cannot be read, or it holds out no photo.
    """
    from gsjax.runs.result import open_result, scene_of_run  # Here, and not above: they import jax.
    from gsjax.runs.run import Run
    from gsjax.scoring.images import score_images

    result, folder, scene = open_result(run), Run.open(run), scene_of_run(Path(run))
    if not scene.held_out_frames:
        raise InputError(f"{run}: holds out no photo")
    found = folder.photography.with_near(scene.frames)
    scores = {
        frame.name: score_images(result.gaussians, (frame,), folder.settings["background"], found=found)
        for frame in scene.held_out_frames
    }
    return {name: next(score[way] for way in WAYS if way in score) for name, score in scores.items()}


def gains(first: Mapping[str, float], other: Mapping[str, float], where: str) -> dict[str, float | None]:
    """Differences of two runs, by view, and their "mean", "error of the mean" (None of one view) and "median".

    Raises:
        InputError: The views are not the same; `where` names the other run.
    """
    if set(first) != set(other):
        raise InputError(f"{where}: does not hold out the same photos as the first run")
    each = {name: other[name] - first[name] for name in first}
    error = stdev(each.values()) / len(each) ** 0.5 if len(each) > 1 else None
    return {**each, "mean": mean(each.values()), "error of the mean": error, "median": median(each.values())}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plain", metavar="PLAIN", help="run folder that the others are compared with")
    parser.add_argument("others", nargs="+", metavar="RUN", help="run folders of the same data set")
    arguments = parser.parse_args()
    sys.exit(run_guarded(lambda: main(arguments.plain, arguments.others)))
