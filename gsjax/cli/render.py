"""Render pictures or a film of a run, of Gaussians or of a mesh.

Writes colour, depth and normals of every view of a run, of its held-out views, or from a
circle around the scene as PNG files. With --turntable, --through-photos or --path and an
output that ends in .mp4, .webm or .gif it writes a film. A file of Gaussians (.ply,
.compressed.ply, .sog, .spz) is seen from cameras placed around it. A mesh (.ply, .obj, .glb)
is seen from outside, with its texture or its vertex colours: a room is seen through its walls.

Example: gsjax render runs/garden --out film.mp4 --turntable
"""

import argparse
from typing import Any

from gsjax.cli.parsers import Command, finite


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("source", metavar="RUN_OR_FILE", help="folder that `gsjax train` made, a file of Gaussians, or a mesh")
    add("--out", metavar="DIR|FILM", required=True, help="folder for the pictures, or the film")
    which = parser.add_mutually_exclusive_group()
    for views, text in (
        ("held-out", "only the held-out views"),
        ("turntable", "a circle around the scene"),
        ("through-photos", "a film past the photos"),
    ):
        which.add_argument(f"--{views}", action="store_const", dest="views", const=views.replace("-", "_"), help=text)
    which.add_argument("--path", metavar="FILE", help="a film along keyframes, as the page of `gsjax share` saves them")
    film = parser.add_argument_group("of films")
    film.add_argument("--seconds", type=finite, metavar="S", help="length (default: 8)")
    film.add_argument("--fps", type=finite, metavar="N", help="pictures a second (default: 30, of a GIF 10)")
    film.add_argument(
        "--size", type=_size, metavar="WxH", help="pixels (default: as the photos, 1280 at most, of a GIF 512)"
    )
    film.add_argument("--what", choices=("image", "depth", "normals"), help="what is shown (default: image)")
    mesh = parser.add_argument_group("of meshes")
    mesh.add_argument(
        "--up", type=finite, nargs=3, metavar=("X", "Y", "Z"), help="direction that points up (default: 0 0 1)"
    )


def run(**options: Any) -> str:
    """Render; return where."""
    from gsjax import pipeline

    return f"rendered: {pipeline.render(**options)}"


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and len(text) < 12):
        raise argparse.ArgumentTypeError(f"{text}: not a size such as 1280x720")
    return int(width), int(height)
