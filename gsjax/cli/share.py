"""Write one page that shows the result in any browser.

Writes one HTML file with a viewer, the Gaussians, a dozen of the photos' cameras, and the mesh of the
run behind a switch. It needs no network and no server: open it, or send it.

Example: gsjax share runs/garden --out garden.html
"""

import sys
from typing import Any

from gsjax.cli.parsers import Command, count

PACKAGES = ("jinja2",)
LARGE = 100_000_000  # bytes of a page that mail and many browsers have trouble with


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("source", metavar="RUN_OR_FILE", help="folder that `gsjax train` made, or a file of Gaussians")
    add("--out", metavar="PAGE.html", required=True, help="the page")
    add("--title", metavar="TEXT", help="title of the page; default: the name of the run or file")
    add("--mesh", metavar="FILE", help=".ply, .obj or .glb to show as well; default: the mesh in the run, if any")
    add("--max-gaussians", type=count, metavar="N", help="only the N Gaussians that cover most, for a smaller page")
    add("--sh-degree", type=int, metavar="N", help="leave out harmonics above this degree, 0-3, for a smaller page")


def run(source: str, out: str, **options: Any) -> dict[str, Any]:
    """Write the page, and report on stderr that it is large."""
    from gsjax import pipeline

    figures = pipeline.share(source, out, **options)
    if figures["bytes"] > LARGE:
        print(f"{out}: is {figures['bytes'] / 1e6:.0f} MB, which many browsers and mail programs refuse;"
            " --max-gaussians N or --sh-degree 0 make it smaller", file=sys.stderr)  # fmt: skip
    return figures
