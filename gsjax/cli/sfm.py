"""`gsjax sfm`: camera poses and a sparse cloud from bare photos."""

import argparse

from gsjax.cli.parsers import add_command


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "sfm",
        _run,
        summary="make a data set (COLMAP) from bare photos",
        description="""
            Finds where each photo was taken (SIFT, matching, incremental mapping), removes the lens
            distortion and writes SCENE/images and SCENE/sparse/0. Prints images registered, points,
            reprojection error.
        """,
        example="gsjax sfm photos/ --out scenes/garden",
    )
    parser.add_argument("photos", metavar="PHOTOS", help="folder of overlapping photos of one still scene")
    parser.add_argument("--out", metavar="SCENE", required=True, help="folder to make: the data set for `gsjax train`")


def _run(arguments: argparse.Namespace) -> None:
    from dataclasses import asdict

    from gsjax import tables
    from gsjax.io import sfm

    print(tables.record(asdict(sfm.reconstruct(arguments.photos, arguments.out))))
