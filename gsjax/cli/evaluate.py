"""`gsjax eval`: how good a run is, in figures."""

import argparse
import sys
from functools import partial

from gsjax.cli.parsers import add_command, add_moved_scene, finite, given_options
from gsjax.io import json_files


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "eval",
        _run,
        summary="score a run on its held-out views",
        description="""
            Prints PSNR, SSIM and, with weights of yours, LPIPS over the held-out views; where the data
            set has true depth, normals or a true surface, also the errors against them: of a mesh from
            point to surface, and the true mesh's own as floor. Pixel masks of the data set are respected.
        """,
        example="gsjax eval runs/garden --json garden.json",
    )
    parser.add_argument("run_folder", metavar="RUN", help="folder that `gsjax train` made")
    parser.add_argument("--json", metavar="FILE", help="also write the figures here")
    parser.add_argument(
        "--three-ways",
        action="store_true",
        help="also score pictures with the gains of the tracks, and after a fitted colour transform, as runs with"
        " effects are scored",
    )
    parser.add_argument(
        "--aligned",
        action="store_true",
        help="also score pictures from the poses that fit the photos best, as runs that move cameras are scored",
    )
    parser.add_argument(
        "--zoom",
        metavar="FACTOR",
        type=finite,
        nargs="+",
        default=[],
        help="also score pictures at so many times the size of training, such as 0.5 2",
    )
    parser.add_argument(
        "--mesh",
        metavar="FILE",
        help="also score this mesh: its texture or colours in the held-out photos, its shape where the truth is known",
    )
    parser.add_argument("--lpips", metavar="FILE", action="append", help="weights of LPIPS as an ONNX file, see"
        " docs/normals.md; may be repeated (default: LPIPS is not scored)")  # fmt: skip
    add_moved_scene(parser)


def _run(arguments: argparse.Namespace) -> None:
    from gsjax import pipeline
    from gsjax.report import tables
    from gsjax.runs.outputs import require_apart

    score = partial(
        pipeline.evaluate,
        arguments.run_folder,
        mesh=arguments.mesh,
        three_ways=arguments.three_ways,
        aligned=arguments.aligned,
        zooms=arguments.zoom,
        **given_options(arguments, "lpips", "scene_folder"),
    )
    if arguments.json:
        require_apart(arguments.json, arguments.run_folder, arguments.mesh, *(arguments.lpips or ()))
    figures = pipeline.noted(arguments.run_folder, "eval", score)
    if arguments.json:
        json_files.write(arguments.json, figures)
    if not figures["views"]:
        print(f"{arguments.run_folder}: no held-out views to score pictures by", file=sys.stderr)
    elif not arguments.lpips:
        print("LPIPS is not scored: --lpips FILE names its weights", file=sys.stderr)
    print(tables.record(figures))
