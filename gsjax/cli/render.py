"""`gsjax render`: pictures of a run, or a film."""

import argparse

from gsjax.cli.parsers import add_command, finite, given_options
from gsjax.errors import InputError

OF_FILMS = ("seconds", "fps", "size", "what")


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "render",
        _run,
        summary="render colour, depth and normals of a run, or a film",
        description="""
            Writes PNG pictures of every view of the run, of its held-out views, or from a circle around it.
            With --path, --orbit or --through-photos it writes a film, .mp4 or .webm.
            A file of Gaussians (.ply, .compressed.ply, .sog, .spz) is seen from cameras placed around it.
        """,
        example="gsjax render runs/garden --out film.mp4 --orbit",
    )
    parser.add_argument(
        "run_folder", metavar="RUN_OR_FILE", help="folder that `gsjax train` made, or a file of Gaussians"
    )
    parser.add_argument("--out", metavar="DIR|FILM", required=True, help="folder for the pictures, or the film")
    which = parser.add_mutually_exclusive_group()
    for flag, text in (("held-out", "only the views kept for scoring"), ("turntable", "a circle around the scene")):
        which.add_argument(f"--{flag}", action="store_const", dest="which", const=flag.replace("-", "_"), help=text)
    which.add_argument("--path", metavar="FILE", help="a film along keyframes, as the page of `gsjax share` saves them")
    for flag, text in (("orbit", "a film around the scene"), ("through-photos", "a film past the photos")):
        which.add_argument(f"--{flag}", action="store_const", dest="path", const=flag.replace("-", "_"), help=text)
    film = parser.add_argument_group("of films")
    film.add_argument("--seconds", type=finite, metavar="S", help="length; default 8")
    film.add_argument("--fps", type=finite, metavar="N", help="pictures a second; default 30")
    film.add_argument("--size", type=_size, metavar="WxH", help="pixels; default: those of the photos, 1280 at most")
    film.add_argument("--what", choices=("image", "depth", "normals"), help="what is shown; default image")
    parser.set_defaults(which="all")


def _run(arguments: argparse.Namespace) -> None:
    from gsjax import pipeline, tables

    if arguments.path is not None:
        options = given_options(arguments, *OF_FILMS)
        print(tables.record(pipeline.film(arguments.run_folder, arguments.out, path=arguments.path, **options)))
        return
    for name in given_options(arguments, *OF_FILMS):
        raise InputError(f"--{name} goes with --path, --orbit or --through-photos")
    pipeline.render(arguments.run_folder, arguments.out, which=arguments.which)
    print(f"pictures: {arguments.out}")


def _size(text: str) -> tuple[int, int]:
    """Width and height of a text such as 1280x720; as the `type` of an argument.

    Raises:
        argparse.ArgumentTypeError: It is none.
    """
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and len(text) < 12):
        raise argparse.ArgumentTypeError(f"{text}: not a size such as 1280x720")
    return int(width), int(height)
