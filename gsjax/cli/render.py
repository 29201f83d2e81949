"""`gsjax render`: pictures of a run."""

import argparse

from gsjax.cli.parsers import add_command


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "render",
        _run,
        summary="render colour, depth and normals of a run",
        description="""
            Writes PNG pictures of every view of the run, of its held-out views, or from a circle around it.
            A file of Gaussians (.ply, .compressed.ply, .spz) is seen from cameras placed around it.
        """,
        example="gsjax render runs/garden --out pictures --turntable",
    )
    parser.add_argument(
        "run_folder", metavar="RUN_OR_FILE", help="folder that `gsjax train` made, or a file of Gaussians"
    )
    parser.add_argument("--out", metavar="DIR", required=True, help="folder for the pictures")
    which = parser.add_mutually_exclusive_group()
    for flag, text in (("held-out", "only the views kept for scoring"), ("turntable", "a circle around the scene")):
        which.add_argument(f"--{flag}", action="store_const", dest="which", const=flag.replace("-", "_"), help=text)
    parser.set_defaults(which="all")


def _run(arguments: argparse.Namespace) -> None:
    from gsjax import pipeline

    pipeline.render(arguments.run_folder, arguments.out, which=arguments.which)
    print(f"pictures: {arguments.out}")
