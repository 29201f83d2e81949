"""`gsjax compare`: several runs on one page."""

import argparse

from gsjax.cli.parsers import add_command


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "compare",
        _run,
        summary="set several runs side by side on one page",
        description="""
            Writes one page that opens anywhere: the settings that differ, scores and curves. Runs that differ by
            their seed alone are pooled: mean, and least and most.
        """,
        example="gsjax compare runs/garden runs/garden_vanilla --out compared.html",
        packages=("jinja2", "matplotlib"),
    )
    parser.add_argument("run_folders", metavar="RUN", nargs="+", help="folders that `gsjax train` or `refine` made")
    parser.add_argument("--out", metavar="FILE", required=True, help="the page, .html")


def _run(arguments: argparse.Namespace) -> None:
    from gsjax import pipeline

    print(pipeline.compare(arguments.run_folders, arguments.out))
