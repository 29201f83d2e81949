"""Make a data set (COLMAP) from bare photos or a video.

Finds where each photo was taken (features, matching, incremental mapping), removes the lens
distortion, turns the photos upright and writes SCENE/images and SCENE/sparse/0. Of a video
the sharpest frame of every stretch is taken. Prints images registered, points, reprojection
error; names the photos left out and the files passed over, and why. Mattes (alpha) and masks
(PHOTOS/masks) are kept. With GPS in the photos (EXIF) the scene is in metres,
x east, y north, z up, and SCENE/place.json says about which origin. Features are SIFT's unless
you have the weights of a network (docs/tasks/photos.md#if-too-few-features-match).

Example: gsjax sfm photos/ --out scenes/garden
"""

import sys
from collections.abc import Mapping
from typing import Any

from gsjax.cli.parsers import Command, finite

PACKAGES = ("pycolmap", "cv2")


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("photos", metavar="PHOTOS_OR_VIDEO", help="folder of overlapping photos of one still scene, or a video of it")
    add("--out", metavar="SCENE", required=True, help="folder to make: the data set for `gsjax train`")
    add_reconstruction(parser)


def add_reconstruction(parser: Command) -> None:
    """Add the options of `gsjax.io.sfm.reconstruct`."""
    add = parser.add_argument
    add("--panoramas", action="store_true", help="the photos, or the video, are"
        " equirectangular: 360 degrees across, 180 down")  # fmt: skip
    add("--mask-below", metavar="DEGREES", type=finite, help="of panoramas, mask what is so far and"
        " farther below the horizon, where the operator is")  # fmt: skip
    add("--features", choices=("sift", "aliked", "disk"), help="what is matched (default: sift); the"
        " others are networks, for photos in which SIFT finds too little")  # fmt: skip
    add("--weights", metavar="FILE", help="of aliked or disk, the network as an ONNX file")
    add("--matcher-weights", metavar="FILE", help="of aliked, LightGlue as an ONNX file (default: the"
        " nearest descriptors match)")  # fmt: skip
    add("--frames", metavar="N", type=int, help="frames to take of a video (default: 100)")


def print_unused(report: Mapping[str, Any]) -> None:
    """Name the photos without a pose, GPS or focal length, and the files that are no photos, a line a reason.

    Another line says which model is kept where there were two.
    """
    for what, files in (
        ("left out", report["left_out"]),
        ("passed over", report["passed_over"]),
        ("GPS not followed", report.get("gps_unused", {})),  # which older reports do not hold
        ("focal length of EXIF ignored", report.get("focal_unused", {})),
    ):
        for reason in dict.fromkeys(files.values()):
            names = [name for name, why in files.items() if why == reason]
            print(f"gsjax: {what} ({reason}): {', '.join(names)}", file=sys.stderr)
    if line := report.get("second_mapping"):
        print(f"gsjax: {line}", file=sys.stderr)


def small_model(report: Mapping[str, Any]) -> list[str]:
    """The last line of a command where less than half of the photos have a pose."""
    if 2 * report["registered"] >= report["images"]:
        return []
    return [
        f"only {report['registered']} of {report['images']} photos are in the model, less than half: see the"
        " photos left out above, and docs/tasks/photos.md#if-too-few-features-match"
    ]


def run(photos: str, out: str, **options: Any) -> str:
    """Reconstruct; return the table."""
    from dataclasses import asdict

    from gsjax.io import sfm
    from gsjax.report import tables

    report = asdict(sfm.reconstruct(photos, out, **options))
    print_unused(report)
    counts = {name: len(report[name]) for name in ("left_out", "passed_over", "gps_unused", "focal_unused")}
    figures = {name: value for name, value in (report | counts).items() if name != "second_mapping"}
    return "\n".join([tables.record(figures), *small_model(report)])
