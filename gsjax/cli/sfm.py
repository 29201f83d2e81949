"""`gsjax sfm`: camera poses and a sparse cloud from bare photos or a video."""

import argparse

from gsjax.cli.parsers import add_command, finite, given_options


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "sfm",
        _run,
        summary="make a data set (COLMAP) from bare photos or a video",
        description="""
            Finds where each photo was taken (features, matching, incremental mapping), removes the lens
            distortion, turns the photos upright and writes SCENE/images and SCENE/sparse/0. Of a video
            the sharpest frame of every stretch is taken. Prints images registered, points, reprojection
            error; names the photos left out and the files passed over, and why. Mattes (alpha) and masks
            (PHOTOS/masks) are kept. Where GPS in the photos (EXIF) tells it, the scene is in metres,
            x east, y north, z up, and SCENE/place.json says about which origin. Features are SIFT's unless
            you have the weights of a network (docs/tasks/hard_photos.md).
        """,
        example="gsjax sfm photos/ --out scenes/garden",
    )
    parser.add_argument(
        "photos", metavar="PHOTOS_OR_VIDEO", help="folder of overlapping photos of one still scene, or a video of it"
    )
    parser.add_argument("--out", metavar="SCENE", required=True, help="folder to make: the data set for `gsjax train`")
    parser.add_argument("--panoramas", action="store_true", default=None, help="the photos, or the video, are"
        " equirectangular: 360 degrees across, 180 down")  # fmt: skip
    parser.add_argument("--mask-below", metavar="DEGREES", type=finite, help="of panoramas, mask what is so far and"
        " farther below the horizon, where the operator is")  # fmt: skip
    parser.add_argument("--features", choices=("sift", "aliked", "disk"), help="what is matched (default: sift); the"
        " others are networks, for photos in which SIFT finds too little")  # fmt: skip
    parser.add_argument("--weights", metavar="FILE", help="of aliked or disk, the network as an ONNX file")
    parser.add_argument("--matcher-weights", metavar="FILE", help="of aliked, LightGlue as an ONNX file (default: the"
        " nearest descriptors match)")  # fmt: skip
    parser.add_argument("--frames", metavar="N", type=int, help="frames to take of a video (default: 100)")


def _run(arguments: argparse.Namespace) -> None:
    import sys
    from dataclasses import asdict

    from gsjax import tables
    from gsjax.io import sfm

    options = given_options(arguments, "frames", "panoramas", "mask_below", "features", "weights", "matcher_weights")
    report = sfm.reconstruct(arguments.photos, arguments.out, **options)
    for what, files in (
        ("left out", report.left_out),
        ("passed over", report.passed_over),
        ("GPS not followed", report.gps_unused),
    ):
        for reason in dict.fromkeys(files.values()):
            names = [name for name, why in files.items() if why == reason]
            print(f"gsjax: {what} ({reason}): {', '.join(names)}", file=sys.stderr)
    counts = {name: len(getattr(report, name)) for name in ("left_out", "passed_over", "gps_unused")}
    print(tables.record(asdict(report) | counts))
