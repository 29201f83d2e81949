"""Photos or a video to a textured mesh, all stages in one go.

Runs sfm, train, mesh, refine and texture, and leaves OUT/scene, OUT/run with its mesh.ply,
OUT/refined, OUT/mesh.glb, OUT/overview.png and OUT/report.json. Called again, it continues
where it stopped. A data set that has camera poses already begins with train. Photos are reconstructed as
`gsjax sfm` does it, with the same options.

Example: gsjax scan photos/ --out scans/garden
"""

from typing import Any

from gsjax.cli.parsers import Command
from gsjax.cli.sfm import add_reconstruction, print_unused, small_model
from gsjax.cli.train import TRAINING, add_training, training
from gsjax.presets import REFINED_BY

PACKAGES = ("open3d", "trimesh", "matplotlib")


def add_arguments(parser: Command) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("source", metavar="PHOTOS_OR_VIDEO", help="folder of photos, a video, or a data set")
    add("--out", metavar="OUT", required=True, help="folder for everything; the same one again to continue")
    add_reconstruction(parser)
    add_training(parser, "how long to train and refine")


def run(source: str, out: str, preset: str, **options: Any) -> str:
    """Run all stages; return the table of them."""
    from gsjax import config, pipeline
    from gsjax.binding.refinement import PRESETS as REFINEMENTS
    from gsjax.binding.refinement import Refinement
    from gsjax.pipeline.scan import table
    from gsjax.report import tables

    training_options = {name: options.pop(name) for name in TRAINING if name in options}
    settings = training(preset, **training_options)
    length = REFINEMENTS[REFINED_BY[preset]]
    refinement = config.parse(Refinement, config.merge(length, {"seed": settings.seed}))
    report = pipeline.scan(source, out, settings, refinement, **options)
    lines = [tables.compare(table(report)), f"mesh: {report['mesh']}, picture: {report['picture']}"]
    if "sfm" in report["stages"]:
        print_unused(report["stages"]["sfm"])
        lines += small_model(report["stages"]["sfm"])
    return "\n".join(lines)
