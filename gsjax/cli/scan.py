"""`gsjax scan`: photos or a video to a textured mesh, all stages in one go."""

import argparse

from gsjax.cli.parsers import add_command
from gsjax.cli.sfm import add_reconstruction, print_if_small, reconstruction, tell_unused
from gsjax.cli.train import add_training, training
from gsjax.presets import REFINED_BY


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "scan",
        _run,
        summary="photos or a video to a textured mesh, all stages in one go",
        description="""
            Runs sfm, train, mesh --method auto, refine and texture, and leaves OUT/scene, OUT/run with its mesh.ply,
            OUT/refined, OUT/mesh.glb, OUT/overview.png and OUT/report.json. Called again, it continues
            where it stopped. A data set that has camera poses already begins with train. Photos are reconstructed as
            `gsjax sfm` does it, with the same options.
        """,
        example="gsjax scan photos/ --out scans/garden",
        packages=("open3d", "trimesh", "matplotlib"),
    )
    add = parser.add_argument
    add("source", metavar="PHOTOS_OR_VIDEO", help="folder of photos, a video, or a data set")
    add("--out", metavar="OUT", required=True, help="folder for everything; the same one again to continue")
    add_reconstruction(parser)
    add_training(parser, "how long to train and refine")


def _run(arguments: argparse.Namespace) -> None:
    from gsjax import config, pipeline
    from gsjax.binding.refinement import PRESETS as REFINEMENTS
    from gsjax.binding.refinement import Refinement
    from gsjax.pipeline.scan import table
    from gsjax.report import tables

    settings = training(arguments)
    length = REFINEMENTS[REFINED_BY[arguments.preset]]
    refinement = config.parse(Refinement, config.merge(length, {"seed": settings.seed}))
    report = pipeline.scan(arguments.source, arguments.out, settings, refinement, **reconstruction(arguments))
    if "sfm" in report["stages"]:
        tell_unused(report["stages"]["sfm"])
    print(tables.compare(table(report)))
    print(f"mesh: {report['mesh']}, picture: {report['picture']}")
    if "sfm" in report["stages"]:
        print_if_small(report["stages"]["sfm"])
