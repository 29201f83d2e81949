"""Show a run or a scan on one page.

Writes RUN/report.html: what was read and decided, curves, held-out photos next to renders, normals,
the mesh, scores, seconds and memory, versions. One file that opens anywhere and loads nothing. train,
refine, scan, eval and mesh write it too; a run that is not finished shows what there is.

Example: gsjax report runs/garden
"""

from gsjax.cli.parsers import Command

PACKAGES = ("jinja2", "matplotlib")


def add_arguments(parser: Command) -> None:
    """Add what `gsjax.pipeline.report` takes."""
    parser.add_argument("folder", metavar="RUN", help="folder that `gsjax train`, `refine` or `scan` made")
