"""`gsjax refine`: a mesh and Gaussians bound to it, trained together."""

import argparse
from collections.abc import Sequence
from typing import Any

from gsjax.cli.parsers import About, add_moved_scene

PRESETS = ("fast", "balanced", "medium", "long")

ABOUT = About(
    summary="refine a mesh with Gaussians bound to it",
    description="""
        Puts flat Gaussians on the triangles of a mesh and trains them and its vertices together on
        the photos of RUN. Gaussians of RUN stay, free, where there is no mesh. Writes OUT/mesh.ply
        and OUT/mesh.glb, OUT/gaussians.ply and OUT/report.json. OUT is a run folder: `gsjax eval OUT`
        and `gsjax render OUT` take it.
    """,
    example="gsjax refine runs/garden --mesh garden.ply --out runs/garden_refined",
    packages=("open3d", "trimesh"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what `run` takes."""
    add = parser.add_argument
    add("run_folder", metavar="RUN", help="folder that `gsjax train` made")
    add("--mesh", metavar="FILE", help="the mesh; .ply, .obj or .glb (default: RUN/mesh.ply)")
    add("--out", metavar="OUT", required=True, help="folder for the result; must be empty")
    add("--preset", choices=PRESETS,
        help="how long: minutes on a CPU, 2.4 to 2.8 times as many, or 7,000 or 15,000 steps for a GPU "
        "(default: fast)")  # fmt: skip
    add("--steps", type=int, metavar="N", help="training steps, instead of the preset's")
    add("--faces", type=int, metavar="N", help="decimate the mesh to at most so many triangles first")
    add("--per-triangle", type=int, choices=(1, 3, 4, 6), help="Gaussians a triangle (default: 1)")
    add("--bound-only", dest="keep_free", action="store_const", const=False,
        help="drop all Gaussians of RUN: nothing shows then where there is no mesh")  # fmt: skip
    refinement = parser.add_mutually_exclusive_group()
    refinement.add_argument("--photo-refine", dest="photo_refine", action="store_const", const=True,
        help="after three fifths of the steps, fit the vertices to the photos (fast, balanced: default)")  # fmt: skip
    refinement.add_argument("--no-photo-refine", dest="photo_refine", action="store_const", const=False,
        help="the mesh stays where its Gaussians have moved it (medium, long: default)")  # fmt: skip
    add("--seed", type=int, metavar="N", help="seed of the order of the photos (default: 0)")
    add("--resume", action="store_true", help="continue OUT from its last checkpoint, given the same options")
    add_moved_scene(parser)
    add("--set", metavar="KEY=VALUE", action="extend", nargs="+", dest="assignments",
        help="any setting by its dotted key, as OUT/config.json shows them; may be repeated")  # fmt: skip


def run(
    run_folder: str,
    out: str,
    preset: str = "fast",
    photo_refine: bool | None = None,
    assignments: Sequence[str] = (),
    **options: Any,
) -> dict[str, Any]:
    """Refine with the settings of the preset, the options, then `--set`."""
    from gsjax import config, pipeline
    from gsjax.binding.refinement import PHOTO_REFINE_AT, PRESETS, Refinement

    handed = {name: options.pop(name) for name in ("mesh", "resume", "scene_folder") if name in options}
    if photo_refine is not None:
        options["photo_refine_at"] = PHOTO_REFINE_AT if photo_refine else 1.0
    settings = config.parse_overridden(Refinement, config.merge(PRESETS[preset], options), assignments)
    return pipeline.refine(run_folder, out, settings, **handed)
