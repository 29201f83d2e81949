"""Trains the variants of a study on one scene, from the same start for the same steps, and prints one table.

First phases that variants have in common are trained once, in OUT/beginnings, and their seconds counted for each. With
--budget for the same time instead: every variant's phases are scaled to what this machine does of them in it.
"""

import argparse
import hashlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from beginnings import beginning
from train import CONFIGS, load_config

from gsjax import config, tables
from gsjax.cli import guarded, parsers
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.settings import Settings

STUDIES = Path(__file__).parent / "studies"
FIGURES = ("psnr", "ssim", "normal_error_deg", "normal_error_all_deg", "mesh_normal_error_deg", "depth_error",
           "chamfer", "fscore_quarter", "fscore_half", "fscore", "normal_consistency", "gaussians", "steps",
           "train_seconds")  # fmt: skip


def run_names(study: str, seeds: int) -> list[str]:
    """VARIANT_SEED of every run of a study, seed by seed."""
    return _names(load_config(study, folder=STUDIES), seeds)


def run(
    study: str, scene: str, out: str, seeds: int = 1, seconds: float | None = None, only: str | None = None
) -> dict[str, list[dict[str, Any]]]:
    """Figures of every variant, a row a seed, and the true mesh's own; also written to `OUT/study.json`.

    A run that is done (`OUT/VARIANT_SEED/study.json`) is not done again, one that was stopped goes on.

    Args:
        study: Name of a file in `studies/`: its `base` names a config, its `variants` hold differences from that, and
            at its `zooms`, if it has any, pictures are scored too (`gsjax.pipeline.evaluate`).
        scene: Data set; "{scene}" in a value of the study stands for it.
        out: Folder for the runs, OUT/VARIANT_SEED each.
        seeds: Runs of every variant, with seeds 0, 1, ...
        seconds: That a run may take; None: its own steps.
        only: The one run that is done, VARIANT_SEED; then `OUT/study.json` is left to who does them all.

    Raises:
        InputError: There is no such study or run, or one of its runs cannot be made.
    """
    described = load_config(study, folder=STUDIES)
    names = _names(described, seeds)
    if only is not None and only not in names:
        raise InputError(f"--only {only}: no run of {study}, whose runs are {', '.join(names)}")
    base = config.merge(load_config("base"), load_config(described["base"], folder=CONFIGS))
    every: dict[str, list[dict[str, Any]]] = {}
    floor: dict[str, Any] = {}
    for seed in range(seeds):
        asked = {
            variant: config.parse(Settings, config.merge(base, _placed(change, scene), {"seed": seed}), where=variant)
            for variant, change in described["variants"].items()
        }
        for variant, settings in asked.items():
            folder = Path(out) / f"{variant}_{seed}"
            if only not in (None, folder.name):
                continue
            done = folder / "study.json"
            if not done.exists():
                print(f"== {folder.name}", flush=True)
                others = [other for name, other in asked.items() if name != variant]
                alone = only is not None or seconds is not None or folder.exists()
                earlier = None if alone else _common(scene, Path(out) / "beginnings", beginning(settings, others))
                _trained(scene, folder, settings, seconds, earlier)
                json_files.write(done, _figures(folder, described.get("zooms", ())))
            figures, floor = json_files.read(done)
            every.setdefault(variant, []).append(figures)
    every |= {tables.FLOOR: [floor]} if floor else {}
    if only is None:
        json_files.write(Path(out) / "study.json", every)
    return every


def _names(described: dict[str, Any], seeds: int) -> list[str]:
    return [f"{variant}_{seed}" for seed in range(seeds) for variant in described["variants"]]


def _common(scene: str, folder: Path, settings: Settings | None) -> Path | None:
    """Where the run that others begin with lies, trained to its end; None of None."""
    from gsjax import pipeline

    if settings is None:
        return None
    name = hashlib.sha256(json.dumps(config.to_dict(settings), sort_keys=True).encode()).hexdigest()[:12]
    run = folder / name
    if not (run / "manifest.json").exists() or json_files.read(run / "manifest.json")["status"] != "done":
        pipeline.train(scene, run, settings, resume=run.exists())
    return run


def _trained(scene: str, folder: Path, settings: Settings, seconds: float | None, earlier: Path | None) -> None:
    from gsjax import pipeline, runs

    if seconds is not None and not folder.exists():
        settings, line = pipeline.budgeted(scene, {folder.name: settings}, seconds)
        print(f"budget: {line}", flush=True)
    elif seconds is not None:
        settings = config.parse(Settings, runs.read_settings(folder))
    pipeline.train(scene, folder, settings, resume=folder.exists(), earlier=earlier)


def _figures(folder: Path, zooms: Sequence[float]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A variant's figures, and those of the true mesh where there is one."""
    from gsjax import pipeline, runs

    figures = pipeline.evaluate(folder, zooms=zooms)
    last = runs.read_metrics(folder)[-20:]
    aligned = [1 - record["terms"]["sdf_normal"] for record in last if "sdf_normal" in record["terms"]]
    wanted = [*FIGURES, *(f"psnr_zoom_{zoom:g}" for zoom in zooms)]
    scores, floor = ({key: f[key] for key in wanted if key in f} for f in (figures, figures.get("floor", {})))
    return scores | ({"mean_cos": np.mean(aligned)} if aligned else {}), floor


def _placed(value: Any, scene: str) -> Any:
    """`value` with "{scene}" in its strings replaced."""
    if isinstance(value, dict):
        return {key: _placed(item, scene) for key, item in value.items()}
    return value.replace("{scene}", scene) if isinstance(value, str) else value


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What a study is told, alone or in a sweep."""
    parser.add_argument("study", metavar="STUDY", help="name of a file in studies/, without .py")
    parser.add_argument("--scene", required=True, help="folder of the data set")
    parser.add_argument("--out", required=True, metavar="DIR", help="empty folder for the runs")
    parser.add_argument("--seeds", type=parsers.count, default=1, metavar="N", help="runs of each variant (default: 1)")
    parser.add_argument("--budget", metavar="TIME", help="of every run, as in 10m (default: the study's steps)")


def main() -> None:
    """Reads the arguments and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    parser.add_argument("--only", metavar="VARIANT_SEED", help="one run of them (default: all)")
    arguments = parser.parse_args()
    seconds = None if arguments.budget is None else parsers.seconds(arguments.budget)
    every = run(arguments.study, arguments.scene, arguments.out, arguments.seeds, seconds, arguments.only)
    print(tables.compare({variant: tables.spread(rows) for variant, rows in every.items()}))


if __name__ == "__main__":
    sys.exit(guarded(main))
