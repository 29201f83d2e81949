"""Take giants and isolated clusters out of Gaussians, or what is outside a box.

Giants fill the picture of the nearest camera; isolated Gaussians are in small clusters apart
from all others. Prints how many of each were taken out. The file as it was is kept as
FILE.original.ply, which --undo restores, and FILE.cleaned.png shows before and after.

Example: gsjax clean runs/garden --crop-to-cameras
"""

from typing import Any

from gsjax.cli.parsers import Command, finite

PACKAGES = ("matplotlib",)


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("source", metavar="RUN_OR_FILE", help="folder that `gsjax train` made, or a file of Gaussians")
    add("--out", metavar="FILE", help="what to write (default: the file itself, of a run its gaussians.ply)")
    add("--scene", metavar="SCENE", help="data set whose cameras to look from, where a file is given")
    add("--crop-to-cameras", action="store_const", const=True, help="keep only the sphere that cameras surround")
    box = ("X0", "Y0", "Z0", "X1", "Y1", "Z1")
    add("--box", type=finite, nargs=6, metavar=box, help="keep only what is in this box, scene coordinates")
    add("--sphere", type=finite, nargs=4, metavar=("X", "Y", "Z", "R"), help="keep only what is in this sphere")
    add("--undo", action="store_true", help="restore what was taken out of RUN_OR_FILE")


def run(source: str, undo: bool = False, **options: Any) -> dict[str, Any]:
    """Clean, or restore what was taken out."""
    from gsjax import pipeline
    from gsjax.errors import InputError
    from gsjax.pipeline.clean import undo as bring_back

    if undo and options:
        raise InputError("--undo goes without other options: it restores all that was taken out of RUN_OR_FILE")
    return bring_back(source) if undo else pipeline.clean(source, **options)
