"""Normal maps of the photos, from a network that you have as an ONNX file.

Runs a monocular network on every photo as training sees it (undistorted) and writes a map
a photo into DIR, for `gsjax train SCENE --normals NETWORK`. What the same weights have made
before is kept, so a stopped run continues. Depth of a network for depth is fitted to the tracks of
structure from motion, and its normals are taken. No weights come with gsjax: docs/normals.md says
where each network's are, under which licence, and how a record describes another network.

Example: gsjax normals scenes/garden --network moge2 --weights moge-2-vitb-normal.onnx
"""

from gsjax.cli.parsers import Command, finite

PACKAGES = ("onnxruntime", "cv2")


def add_arguments(parser: Command) -> None:
    """Add what `gsjax.pipeline.normals` takes."""
    add = parser.add_argument
    add("scene", metavar="SCENE", help="folder of the data set")
    add("--network", metavar="NAME", required=True, help="moge2, metric3d, omnidata, dsine; for depth midas,"
        " depth_anything_v2; or a JSON file that describes another one")  # fmt: skip
    add("--weights", metavar="FILE", required=True, help="the network as an ONNX file")
    add("--out", metavar="DIR", help="folder of the maps (default: SCENE/normals_NETWORK)")
    add("--downscale", type=finite, metavar="K", help="make the maps K times smaller than the photos (default: to 1600"
        " pixels)")  # fmt: skip
    add("--images", metavar="FOLDER", help="folder of the photos, within SCENE or absolute (default: found by name)")
