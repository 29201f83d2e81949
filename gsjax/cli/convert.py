"""Write Gaussians as a file for other programs, or read theirs.

Reads and writes by suffix: .ply as 3DGS has it, .compressed.ply and .sog of PlayCanvas, .spz of
Niantic (written as version 3, read as 2, 3 and 4). The pixel filter goes along in each of them.

Example: gsjax convert runs/garden garden.spz --min-opacity 0.02
"""

import sys
from typing import Any

from gsjax.cli.parsers import Command


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("source", metavar="IN", help="file of Gaussians, or folder that `gsjax train` made")
    add("out", metavar="OUT", help=".ply, .compressed.ply, .sog or .spz")
    add("--sh-degree", type=int, metavar="N", help="leave out harmonics above this degree, 0-4")
    box = ("X0", "Y0", "Z0", "X1", "Y1", "Z1")
    add("--crop", type=float, nargs=6, metavar=box, help="only Gaussians whose means are in this box of the world")
    add("--min-opacity", type=float, metavar="A", help="only Gaussians at least so opaque, 0-1")


def run(source: str, out: str, **options: Any) -> dict[str, Any]:
    """Convert, and report on stderr what the format cannot hold."""
    from gsjax import pipeline

    figures = pipeline.convert(source, out, **options)
    if figures["clipped"]:
        print(f"{out}: {figures['clipped']} of {figures['gaussians']} Gaussians hold values beyond what the format"
            " reaches without taking precision from the others; they were clipped", file=sys.stderr)  # fmt: skip
    if figures["stored_at"]:
        print(f"{out}: stores {figures['stored_at']}; {out}.similarity.json has the similarity", file=sys.stderr)
    return figures
