"""`gsjax convert`: files of Gaussians for other programs, and of them."""

import argparse
import sys

from gsjax.cli.parsers import add_command, given_options


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "convert",
        _run,
        summary="write Gaussians as a file for other programs, or read theirs",
        description="""
            Reads and writes by suffix: .ply as 3DGS has it, .compressed.ply and .sog of PlayCanvas, .spz of
            Niantic (written as version 3, read as 2, 3 and 4). The pixel filter goes along in each of them.
        """,
        example="gsjax convert runs/garden garden.spz --min-opacity 0.02",
    )
    add = parser.add_argument
    add("source", metavar="IN", help="file of Gaussians, or folder that `gsjax train` made")
    add("out", metavar="OUT", help=".ply, .compressed.ply, .sog or .spz")
    add("--sh-degree", type=int, metavar="N", help="leave out harmonics above this degree, 0-4")
    box = ("X0", "Y0", "Z0", "X1", "Y1", "Z1")
    add("--crop", type=float, nargs=6, metavar=box, help="only Gaussians whose means lie in this box of the world")
    add("--min-opacity", type=float, metavar="A", help="only Gaussians at least so opaque, 0-1")


def _run(arguments: argparse.Namespace) -> None:
    from gsjax import pipeline
    from gsjax.report import tables

    options = given_options(arguments, "sh_degree", "crop", "min_opacity")
    figures = pipeline.convert(arguments.source, arguments.out, **options)
    if figures["clipped"]:
        print(f"{arguments.out}: {figures['clipped']} of {figures['gaussians']} Gaussians hold values beyond what the"
            " format reaches without taking precision from the others; they were clipped", file=sys.stderr)  # fmt: skip
    if figures["stored_at"]:
        print(f"{arguments.out}: holds {figures['stored_at']}, as {arguments.out}.similarity.json beside it tells",
            file=sys.stderr)  # fmt: skip
    print(tables.record(figures))
