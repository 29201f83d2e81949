"""Paint a mesh with what the Gaussians show.

Lays a mesh out in a square texture and gives every texel what the training views that see it
show there. Where none does, the mesh's own vertex colours remain.

Example: gsjax texture runs/garden --mesh garden.ply --out garden.glb
"""

from gsjax.cli.parsers import Command

PACKAGES = ("open3d", "trimesh")


def add_arguments(parser: Command) -> None:
    """Add what `gsjax.pipeline.texture` takes."""
    add = parser.add_argument
    add("source", metavar="RUN_OR_FILE", help="folder that `gsjax train` made, or a file of Gaussians")
    add("--mesh", metavar="FILE", required=True, help="the mesh that `gsjax mesh` made of it")
    add("--out", metavar="FILE", required=True, help=".glb, .usdz for phones, or .obj with .mtl and .png next to it")
    add("--size", type=int, metavar="PX", help="side of the texture; default: as fine as the photos, 4096 at most")
    add("--scene", metavar="SCENE", help="data set whose cameras to look from, where a file is given")
