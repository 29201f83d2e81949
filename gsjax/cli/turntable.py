"""`gsjax turntable`: pictures around a mesh."""

import argparse

from gsjax.cli.parsers import add_command, finite, given_options


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "turntable",
        _run,
        summary="draw a mesh from all around",
        description="""
            Draws any mesh file from a circle around it, with its texture or its vertex colours, without a
            display. Faces are seen from outside only: a room is looked into through its walls.
        """,
        example="gsjax turntable garden.glb --out garden.gif --frames 36",
    )
    parser.add_argument("mesh", metavar="MESH", help=".ply, .obj or .glb")
    parser.add_argument("--out", metavar="FILE", required=True, help=".gif that turns, or .png with pictures in a row")
    parser.add_argument("--frames", type=int, metavar="N", help="pictures in a full turn; default: 36")
    parser.add_argument("--size", type=int, metavar="PX", help="side of a picture; default: 512")
    parser.add_argument(
        "--up", type=finite, nargs=3, metavar=("X", "Y", "Z"), help="direction that points up; default: 0 0 1"
    )


def _run(arguments: argparse.Namespace) -> None:
    from gsjax import pipeline

    options = given_options(arguments, "frames", "size", "up")
    print(f"pictures: {pipeline.turntable(arguments.mesh, arguments.out, **options)}")
