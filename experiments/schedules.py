"""Are steps better spent on R or on the refinement? The paper's two budgets in small.

    python experiments/schedules.py --scene SCENE --out DIR [--share 0.1] [--seeds N]

SCENE is a data set with a true surface; its `normals` are used where it has them. Both budgets are run with all their
steps times the share, training, mesh and refinement, and scored before and after the refinement. Called again it goes
on after the runs that are done.
"""

import argparse
import shutil
import sys
from pathlib import Path
from typing import Any

from paper.scenes import PAPER_MESH, SCHEDULES

from gsjax import tables
from gsjax.cli import parsers, run_guarded
from gsjax.io import json_files

BUDGETS = ("paper_6k_15k", "paper_13k_7k")
FIGURES = ("psnr", "ssim", "normal_error_deg", "normal_error_all_deg", "chamfer", "fscore", "normal_consistency")


def run(
    scene: str, out: str, *, share: float, seeds: int = 1, most: int = 12_000, background: str = "white"
) -> dict[str, list[dict[str, Any]]]:
    """By budget and stage, a row a seed.

    Args:
        scene: Data set with a true surface.
        out: Folder for the runs, OUT/BUDGET_SEED each.
        share: Of all steps.
        seeds: Runs of either budget, with seeds 0, 1, ...
        most: Gaussians.
        background: Under the photos.
    """
    rows: dict[str, list[dict[str, Any]]] = {}
    for seed in range(seeds):
        for budget in BUDGETS:
            folder = Path(out) / f"{budget}_{seed}"
            done = folder / "schedule.json"
            if not done.exists():
                print(f"== {folder.name}", flush=True)
                shutil.rmtree(folder, ignore_errors=True)
                given = {"seed": seed, "max_gaussians": most, "background": background}
                json_files.write(done, _measured(Path(scene), folder, budget, share, given))
            for stage, figures in json_files.read(done).items():
                rows.setdefault(f"{budget}, {stage}", []).append(figures)
    return rows


def _measured(scene: Path, folder: Path, budget: str, share: float, given: dict[str, Any]) -> dict[str, Any]:
    """Figures of one run before and after its refinement."""
    from gsjax import pipeline
    from gsjax.binding.refining import PRESETS as REFINEMENTS
    from gsjax.binding.refining import Refinement
    from gsjax.config import merge, parse
    from gsjax.settings import PRESETS, Settings

    schedule, normals = SCHEDULES[budget], scene / "normals"
    given = given | ({"normals": str(normals)} if normals.is_dir() else {})
    settings = pipeline.scaled(parse(Settings, merge(PRESETS[schedule.preset], schedule.differences, given)), share)
    refined = {
        "keep_free": False,  # the paper's Gaussians are on the mesh alone
        "faces": 30_000,
        "rates": REFINEMENTS["fast"]["rates"],  # few steps, large ones: docs/refinement.md
        "steps": round(share * REFINEMENTS[str(schedule.refinement)]["steps"]),
        "seed": given["seed"],
    }
    refinement = parse(Refinement, refined)
    trained, bound = folder / "run", folder / "refined"
    pipeline.train(scene, trained, settings)
    pipeline.mesh(trained, trained / "mesh.ply", **PAPER_MESH)
    pipeline.refine(trained, bound, refinement)
    return {"trained": _figures(trained), "refined": _figures(bound)}


def _figures(folder: Path) -> dict[str, float]:
    from gsjax import pipeline

    figures = pipeline.evaluate(folder, mesh=folder / "mesh.ply")
    return {name: figures[name] for name in FIGURES}


def main() -> None:
    """Reads the arguments and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", required=True, help="folder of the data set")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the runs")
    parser.add_argument("--share", type=float, default=0.1, help="of all steps (default: 0.1)")
    parser.add_argument("--seeds", type=parsers.count, default=1, metavar="N", help="runs of each budget (default: 1)")
    arguments = parser.parse_args()
    rows = run(arguments.scene, arguments.out, share=arguments.share, seeds=arguments.seeds)
    print(tables.compare({label: tables.spread(each) for label, each in rows.items()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
