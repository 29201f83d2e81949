"""Set several runs side by side on one page.

Writes one page that opens anywhere: the settings that differ, scores and curves. Runs that differ by
their seed alone are pooled: mean, and least and most.

Example: gsjax compare runs/garden runs/garden_vanilla --out compared.html
"""

from gsjax.cli.parsers import Command

PACKAGES = ("jinja2", "matplotlib")


def add_arguments(parser: Command) -> None:
    """Add what `gsjax.pipeline.compare` takes."""
    parser.add_argument("folders", metavar="RUN", nargs="+", help="folders that `gsjax train` or `refine` made")
    parser.add_argument("--out", metavar="FILE", required=True, help="the page, .html")
