"""`gsjax report`: a run, or a whole scan, as one page."""

from gsjax.cli.parsers import About, Command

ABOUT = About(
    summary="show a run or a scan on one page",
    description="""
        Writes RUN/report.html: what was read and decided, curves, held-out photos next to renders, normals,
        the mesh, scores, seconds and memory, versions. One file that opens anywhere and loads nothing. train,
        refine, scan, eval and mesh write it too; a run that is not finished shows what there is.
    """,
    example="gsjax report runs/garden",
    packages=("jinja2", "matplotlib"),
)


def add_arguments(parser: Command) -> None:
    """Add what `gsjax.pipeline.report` takes."""
    parser.add_argument("folder", metavar="RUN", help="folder that `gsjax train`, `refine` or `scan` made")
