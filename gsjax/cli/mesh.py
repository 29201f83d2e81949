"""`gsjax mesh`: Gaussians to a mesh."""

import argparse

from gsjax.cli.parsers import add_command, given


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "mesh",
        _run,
        summary="extract a mesh from a run or from any 3DGS .ply",
        description="""
            Finds points of the surface along the cameras' rays, reconstructs a mesh from them (Poisson),
            trims what no point supports and colours the vertices. A .ply alone has no cameras: give
            --scene.
        """,
        example="gsjax mesh runs/garden --out garden.glb",
    )
    add = parser.add_argument
    add("source", metavar="RUN_OR_PLY", help="folder that `gsjax train` made, or a .ply of Gaussians")
    add("--out", metavar="FILE", required=True, help="the mesh; .ply, .obj or .glb by its suffix")
    add("--depth", type=int, metavar="N", help="depth of the Poisson octree: one more doubles the resolution")
    add("--trim-quantile", type=float, metavar="Q", help="share (0..1) of vertices, the least supported, to cut away")
    add("--level", type=float, metavar="L", help="density (0..1) at which the surface lies")
    add("--points", type=int, metavar="N", help="number of surface points to reconstruct from")
    add("--bounds", type=float, nargs=6, metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="keep only what lies in this box, scene coordinates")  # fmt: skip
    add("--scene", metavar="SCENE", help="data set whose cameras to look from, where a .ply is given")


def _run(arguments: argparse.Namespace) -> None:
    from gsjax import pipeline, tables

    options = given(arguments, "depth", "trim_quantile", "level", "points", "bounds", "scene")
    print(tables.record(pipeline.mesh(arguments.source, arguments.out, **options)))
