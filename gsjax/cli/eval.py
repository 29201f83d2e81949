"""Score a run on its held-out views.

Prints PSNR, SSIM and, with weights of yours, LPIPS over the held-out views; where the data
set has true depth, normals or a true surface, also the errors against them: of a mesh from
point to surface, and the true mesh's own as floor. Pixel masks of the data set are respected.

Example: gsjax eval runs/garden --json garden.json
"""

import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

from gsjax.cli.parsers import Command, add_moved_scene, finite
from gsjax.io import json_files


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("run_folder", metavar="RUN", help="folder that `gsjax train` made")
    add("--json", metavar="FILE", help="also write the figures here")
    add("--three-ways", action="store_true", help="also score pictures with the gains of the tracks, and after"
        " a fitted colour transform, as runs with effects are scored")  # fmt: skip
    add("--aligned", action="store_true", help="also score pictures from the poses that fit the photos best, as"
        " runs that move cameras are scored")  # fmt: skip
    add("--zoom", metavar="FACTOR", type=finite, nargs="+", dest="zooms", help="also score pictures at so many"
        " times the size of training, such as 0.5 2")  # fmt: skip
    add("--mesh", metavar="FILE", help="also score this mesh: its texture or colours in the held-out photos, its"
        " shape where the truth is known")  # fmt: skip
    add("--lpips", metavar="FILE", action="append", help="weights of LPIPS as an ONNX file, see"
        " docs/normals.md; may be repeated (default: LPIPS is not scored)")  # fmt: skip
    add_moved_scene(parser)


def run(
    run_folder: str, json: str | None = None, mesh: str | None = None, lpips: Sequence[str] = (), **options: Any
) -> dict[str, Any]:
    """Score, note the figures in the run, and write them where they are to be."""
    from gsjax import pipeline
    from gsjax.runs.outputs import require_apart

    if json:
        require_apart(json, run_folder, mesh, *lpips)
    score = partial(pipeline.evaluate, run_folder, mesh=mesh, lpips=lpips, **options)
    figures = pipeline.record_stage(run_folder, "eval", score)
    if json:
        json_files.write(json, figures)
    if not figures["views"]:
        print(f"{run_folder}: no held-out views to score pictures by", file=sys.stderr)
    elif not lpips:
        print("LPIPS is not scored: --lpips FILE names its weights", file=sys.stderr)
    return figures
