"""`gsjax mesh`: Gaussians to a mesh."""

import argparse

from gsjax.cli.parsers import add_command, finite, given_options

BOX = ("X0", "Y0", "Z0", "X1", "Y1", "Z1")


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "mesh",
        _run,
        summary="extract a mesh from a run or from any file of Gaussians",
        description="""
            Leaves out Gaussians that hang in the air, finds points of the surface along the cameras' rays,
            reconstructs a mesh from them (Poisson), trims what no point supports and colours the vertices.
            Where the training photos exist, the vertices then move to where these agree. A file alone
            has no cameras: give --scene, or some are placed around (or, in a room, within) the Gaussians.
        """,
        example="gsjax mesh runs/garden --out garden.glb",
        packages=("open3d", "trimesh"),
        listing=_methods,
    )
    add = parser.add_argument
    add("source", metavar="RUN_OR_FILE", help="folder that `gsjax train` made, or a file of Gaussians")
    add("--out", metavar="FILE", required=True, help="the mesh; .ply, .obj or .glb by its suffix")
    add("--method", metavar="METHOD", help="how the surface is found: poisson (default), another of the methods below,"
        " or auto, as in scan: the one that agrees clearly more than poisson with points that photos share, or where"
        " there are none with the photos' mattes")  # fmt: skip
    add("--depth", type=int, metavar="N", help="depth of the Poisson octree: one more doubles the resolution")
    add("--trim-quantile", type=finite, metavar="Q",
        help="share (0..1) of vertices, the least supported, to cut away; default: by the points' density")  # fmt: skip
    add("--cell", type=finite, metavar="C", help="side of a voxel (tsdf), scene units")
    add("--level", type=finite, metavar="L", help="density (0..1) at which the surface lies (poisson)")
    add("--points", type=int, metavar="N", help="number of surface points to reconstruct from")
    add("--bounds", type=finite, nargs=6, metavar=BOX, help="keep only what lies in this box, scene coordinates")
    add("--background-bounds", type=finite, nargs=6, metavar=BOX,
        help="reconstruct what lies in this box and not in --bounds too, at its own resolution")  # fmt: skip
    add("--foreground-only", action="store_const", const=True, help="no background, whatever there is")
    add("--faces", type=int, metavar="N", help="most triangles, of the foreground and of the background each")
    add("--unsettled", dest="settled", action="store_const", const=False,
        help="leave the surface where the Gaussians have it")  # fmt: skip
    add("--fill-holes", dest="holes_filled", action="store_const", const=True,
        help="close holes where two views show a surface; others stay open; after agreed always")  # fmt: skip
    add("--keep-floaters", action="store_const", const=True,
        help="use Gaussians too that hang in the air: shown by one view alone, looked through by others")  # fmt: skip
    add("--scene", metavar="SCENE", help="data set whose cameras to look from, where a file is given; of a run,"
        " where its data set is, if it was moved")  # fmt: skip


def _methods() -> str:
    from gsjax.meshing.methods import methods_help

    return methods_help()


def _run(arguments: argparse.Namespace) -> None:
    from gsjax import pipeline
    from gsjax.report import tables

    options = given_options(
        arguments, "method", "depth", "trim_quantile", "cell", "level", "points", "bounds", "background_bounds",
        "foreground_only", "faces", "scene", "settled", "holes_filled", "keep_floaters",
    )  # fmt: skip
    figures = pipeline.noted(
        arguments.source, "mesh", lambda: pipeline.mesh(arguments.source, arguments.out, **options)
    )
    print(tables.record(figures))
