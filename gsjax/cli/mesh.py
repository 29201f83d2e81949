"""Extract a mesh from a run or from any file of Gaussians.

Leaves out Gaussians that hang in the air, finds points of the surface along the cameras' rays,
reconstructs a mesh from them (Poisson), trims what no point supports and colours the vertices.
Where the training photos exist, the vertices are then refined on them. A file alone
has no cameras: give --scene, or some are placed around (or, in a room, within) the Gaussians.

Example: gsjax mesh runs/garden --out garden.glb
"""

from functools import partial
from typing import Any

from gsjax.cli.parsers import Command, finite

PACKAGES = ("open3d", "trimesh")
BOX = ("X0", "Y0", "Z0", "X1", "Y1", "Z1")


def listing() -> str:
    """The methods, which the help lists."""
    from gsjax.meshing.methods import methods_help

    return methods_help()


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("source", metavar="RUN_OR_FILE", help="folder that `gsjax train` made, or a file of Gaussians")
    add("--out", metavar="FILE", required=True, help="the mesh; .ply, .obj or .glb by its suffix")
    add("--method", metavar="METHOD", help="how the surface is found: one of the methods below, or auto (default):"
        " poisson, or another that reads the given options and fits the matched points clearly better, or"
        " where there are none the photos' mattes")  # fmt: skip
    add("--depth", type=int, metavar="N", help="depth of the Poisson octree: one more doubles the resolution")
    add("--trim-quantile", type=finite, metavar="Q",
        help="share (0..1) of vertices, the least supported, to cut away; default: by the points' density")  # fmt: skip
    add("--cell", type=finite, metavar="C", help="side of a voxel (tsdf), scene units")
    add("--level", type=finite, metavar="L", help="density (0..1) at which the surface is (poisson)")
    add("--points", type=int, metavar="N", help="number of surface points to reconstruct from")
    add("--bounds", type=finite, nargs=6, metavar=BOX, help="keep only what is in this box, scene coordinates")
    add("--background-bounds", type=finite, nargs=6, metavar=BOX,
        help="reconstruct what is in this box and not in --bounds too, at its own resolution")  # fmt: skip
    add("--foreground-only", action="store_const", const=True, help="no background, whatever there is")
    add("--faces", type=int, metavar="N", help="most triangles, of the foreground and of the background each")
    add("--no-photo-refine", dest="photo_refine", action="store_const", const=False,
        help="leave the surface where the Gaussians have it")  # fmt: skip
    add("--fill-holes", action="store_const", const=True,
        help="close holes where two views show a surface; others stay open")  # fmt: skip
    add("--keep-floaters", action="store_const", const=True,
        help="use Gaussians too that hang in the air: shown by one view alone, looked through by others")  # fmt: skip
    add("--scene", metavar="SCENE", help="data set whose cameras to look from, where a file is given; of a run,"
        " where its data set is, if it was moved")  # fmt: skip


def run(source: str, **options: Any) -> dict[str, Any]:
    """Extract the mesh, and note the figures in the run."""
    from gsjax import pipeline

    return pipeline.record_stage(source, "mesh", partial(pipeline.mesh, source, **options))
