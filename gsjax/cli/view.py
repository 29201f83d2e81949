"""Show a run, Gaussians or a mesh in the browser.

Serves a page until Ctrl-C: Gaussians as this program's rasterizer draws them, coarse while the
camera moves and full at rest, or as the browser does; colour, depth, normals, the mesh, the
cameras with their photos.

Example: gsjax view runs/garden
"""

from typing import Any

from gsjax.cli.parsers import Command

PACKAGES = ("viser",)


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("source", metavar="RUN_OR_FILE", help="folder that `gsjax train` made, or a file of Gaussians (.ply,"
        " .compressed.ply, .sog, .spz) or of a mesh (.ply, .obj, .glb)")  # fmt: skip
    add("--mesh", metavar="FILE", help="mesh to show over the Gaussians (default: RUN/mesh.ply, if there is one)")
    add_address(parser)


def add_address(parser: Command) -> None:
    """Where a page is served."""
    parser.add_argument("--port", type=int, metavar="N", help="port of the page; 0: a free one (default: 8080)")
    parser.add_argument("--host", metavar="ADDRESS", help="address to listen on, 0.0.0.0 for every one of this machine;"
        " who reaches it sees the page (default: 127.0.0.1, this machine alone)")  # fmt: skip


def run(source: str, **options: Any) -> None:
    """Serve the page."""
    from gsjax import viewer

    viewer.view(source, **options)
