"""`gsjax report`: a run, or a whole scan, as one page."""

import argparse

from gsjax.cli.parsers import add_command


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "report",
        _run,
        summary="show a run or a scan on one page",
        description="""
            Writes RUN/report.html: what was read and decided, curves, held-out photos next to renders, normals,
            the mesh, scores, seconds and memory, versions. One file that opens anywhere and loads nothing. train,
            refine, scan, eval and mesh write it too; a run that is not finished shows what there is.
        """,
        example="gsjax report runs/garden",
        packages=("jinja2", "matplotlib"),
    )
    parser.add_argument("run_folder", metavar="RUN", help="folder that `gsjax train`, `refine` or `scan` made")


def _run(arguments: argparse.Namespace) -> None:
    from gsjax import pipeline

    print(pipeline.report(arguments.run_folder))
