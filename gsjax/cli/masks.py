"""Masks that leave out people, sky and the like, from a network that you have as an ONNX file.

Runs a segmentation network on every photo and writes PHOTOS/masks/NAME.png: 0 where the photo
shows one of the classes, 255 elsewhere. `gsjax sfm`, `gsjax train` and `gsjax mesh` use only
the rest. No weights come with gsjax: docs/tasks/masks_and_sky.md says where to get them, under which
licence, and how a record describes another network.

Example: gsjax masks photos/ --network pphumanseg --weights human_segmentation_pphumanseg_2023mar.onnx
"""

from gsjax.cli.parsers import Command

PACKAGES = ("onnxruntime", "cv2")


def add_arguments(parser: Command) -> None:
    """Add what `gsjax.pipeline.masks` takes."""
    add = parser.add_argument
    add("photos", metavar="PHOTOS_OR_SCENE", help="folder of photos, or of a data set")
    add("--network", metavar="NAME", required=True, help="pphumanseg, u2net, skyseg, or a JSON file that describes"
        " another one")  # fmt: skip
    add("--weights", metavar="FILE", required=True, help="the network as an ONNX file")
    add(
        "--classes",
        type=lambda names: [name.strip() for name in names.split(",")],
        metavar="A,B",
        help="what to leave out (default: the only class that is not background)",
    )
    add("--invert", action="store_true", help="leave out everything else instead")
    add("--out", metavar="DIR", help="folder to make; absent or empty (default: PHOTOS_OR_SCENE/masks)")
    add("--images", metavar="FOLDER", help="of a data set, the folder of the photos (default: found by name)")
