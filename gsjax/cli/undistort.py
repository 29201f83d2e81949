"""Write the photos as training sees them: undistorted, cropped, downscaled.

For networks and programs that want pinhole photos: reads what `gsjax train` reads and writes
DIR/images, DIR/masks where not every pixel counts, DIR/sparse/0 and DIR/hold_out.txt. DIR is
a data set that trains the same. Normal maps made of DIR/images belong to `gsjax train DIR`.

Example: gsjax undistort scenes/garden --out scenes/garden_pinhole
"""

from gsjax.cli.parsers import Command, finite

PACKAGES = ("pycolmap", "cv2")


def add_arguments(parser: Command) -> None:
    """Add what `gsjax.pipeline.undistort` takes."""
    add = parser.add_argument
    add("scene", metavar="SCENE", help="folder of the data set")
    add("--out", metavar="DIR", required=True, help="folder to make; absent or empty")
    add("--downscale", type=finite, metavar="K", help="make the photos K times smaller (default: 1)")
    add("--images", metavar="FOLDER", help="folder of the photos, within SCENE or absolute (default: found by name)")
