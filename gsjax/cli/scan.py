"""`gsjax scan`: photos or a video to a textured mesh, all stages in one go."""

import argparse

from gsjax.cli.parsers import add_command, finite
from gsjax.cli.sfm import add_reconstruction, reconstruction, tell_unused
from gsjax.settings import PRESETS, REFINED_BY


def add_to(commands: argparse._SubParsersAction) -> None:
    """Adds the command."""
    parser = add_command(
        commands,
        "scan",
        _run,
        summary="photos or a video to a textured mesh, all stages in one go",
        description="""
            Runs sfm, train, mesh, refine and texture, and leaves OUT/scene, OUT/run with its mesh.ply,
            OUT/refined, OUT/mesh.glb, OUT/overview.png and OUT/report.json. Called again, it goes on where
            it stopped. A data set that has camera poses already begins with train. Photos are reconstructed as
            `gsjax sfm` does it, with the same options.
        """,
        example="gsjax scan photos/ --out scans/garden",
    )
    add = parser.add_argument
    add("source", metavar="PHOTOS_OR_VIDEO", help="folder of photos, a video, or a data set")
    add("--out", metavar="OUT", required=True, help="folder for everything; the same one again to go on")
    add_reconstruction(parser)
    add("--preset", choices=PRESETS, default="fast", help="how long to train and refine (default: fast)")
    add("--seed", type=int, metavar="N", help="seed of all random numbers (default: 0)")
    add("--downscale", type=finite, metavar="K", help="make the photos K times smaller (default: as `gsjax train`)")
    add("--hold-out", metavar="N|none|FILE", help="photos for scoring only (default: as `gsjax train`)")
    add("--set", metavar="KEY=VALUE", action="append", nargs="+", default=[], dest="assignments",
        help="any setting of the training by its dotted key; may be repeated")  # fmt: skip


def _run(arguments: argparse.Namespace) -> None:
    from gsjax import config, pipeline, tables
    from gsjax.binding.refining import PRESETS as REFINEMENTS
    from gsjax.binding.refining import Refinement
    from gsjax.cli.train import override_settings
    from gsjax.pipeline.scan import table

    settings = override_settings(PRESETS[arguments.preset], arguments, "seed", "downscale", "hold_out")
    length = REFINEMENTS[REFINED_BY[arguments.preset]]
    refinement = config.parse(Refinement, config.merge(length, {"seed": settings.seed}))
    report = pipeline.scan(arguments.source, arguments.out, settings, refinement, **reconstruction(arguments))
    if "sfm" in report["stages"]:
        tell_unused(report["stages"]["sfm"])
    print(tables.compare(table(report)))
    print(f"mesh: {report['mesh']}, picture: {report['picture']}")
