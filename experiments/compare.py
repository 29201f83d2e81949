"""How do the variants of a study compare, trained on one scene from the same start?

    python experiments/compare.py STUDY --scene PATH --out DIR [--on CONFIG] [--seeds N] [--budget TIME]

Variants run for the steps that the study says. First phases that they have in common are trained once, in
OUT/beginnings, and their seconds counted for each. With --budget they run for the same time instead: every variant's
phases are scaled to what this machine does of them in it. Called again it goes on where it was stopped.
"""

import argparse
import hashlib
import json
import runpy
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from configs import CONFIGS
from train import claim, load_config, nearest

from gsjax import config, tables
from gsjax.cli import parsers, run_guarded
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.settings import Settings

STUDIES = Path(__file__).parent / "studies"
FIGURES = ("psnr", "ssim", "normal_error_deg", "normal_error_all_deg", "mesh_normal_error_deg", "depth_error",
           "chamfer", "fscore_quarter", "fscore_half", "fscore", "normal_consistency", "gaussians", "steps",
           "train_seconds")  # fmt: skip
WAYS = ("near_gains", "track_gains", "fitted")  # of scoring pictures whose exposure differs


class Study(NamedTuple):
    """What is compared."""

    on: str  # name of a config
    config: dict[str, Any]  # the whole of it
    variants: dict[str, dict[str, Any]]  # differences from it by name
    evaluated: dict[str, Any]  # options of `gsjax.pipeline.evaluate`


def load_study(name: str, on: str | None = None) -> Study:
    """A study of `studies/NAME.py` on a config; None: on the study's own, `ON`.

    Its `variants(config, on)` tells the differences from that config; "{scene}" in them stands for the data set.

    Raises:
        InputError: There is no such study, or no such config.
    """
    path = STUDIES / f"{name}.py"
    if not path.is_file():
        raise InputError(f"no study '{name}'; the nearest is '{nearest(name, (p.stem for p in STUDIES.glob('*.py')))}'")
    module = runpy.run_path(str(path))
    on = on or module["ON"]
    base = load_config(on)
    return Study(on, base, module["variants"](base, on), module.get("EVALUATED", {}))


def run_names(variants: Mapping[str, Any], seeds: int) -> list[str]:
    """VARIANT_SEED of every run, seed by seed."""
    return [f"{variant}_{seed}" for seed in range(seeds) for variant in variants]


def run(
    study: str,
    scene: str,
    out: str,
    seeds: int = 1,
    *,
    on: str | None = None,
    seconds: float | None = None,
    only: str | None = None,
) -> dict[str, list[dict[str, Any]]]:
    """Figures of every variant, a row a seed, and the true mesh's own; also written to `OUT/study.json`.

    A run that is done (`OUT/VARIANT_SEED/study.json`) is not done again, one that was stopped goes on.

    Args:
        study: As in `load_study`.
        scene: Data set; "{scene}" in a value of the study stands for it.
        out: Folder for the runs, OUT/VARIANT_SEED each.
        seeds: Runs of every variant, with seeds 0, 1, ...
        on: Name of a config; None: the study's own.
        seconds: That a run may take; None: its own steps.
        only: The one run that is done, VARIANT_SEED; then `OUT/study.json` is left to who does them all.

    Raises:
        InputError: There is no such study or run, `out` holds runs of another, or one of its runs cannot be made.
    """
    from common_phases import beginning  # Here, and not above: it imports jax.

    described = load_study(study, on)
    names = run_names(described.variants, seeds)
    if only is not None and only not in names:
        raise InputError(f"--only {only}: no run of {study}, whose runs are {', '.join(names)}")
    claim(Path(out), {"study": study, "on": described.on, "scene": str(Path(scene).resolve())})
    every: dict[str, list[dict[str, Any]]] = {}
    floor: dict[str, Any] = {}
    for seed in range(seeds):
        asked = {
            variant: config.parse(
                Settings, config.merge(described.config, _placed(change, scene), {"seed": seed}), where=variant
            )
            for variant, change in described.variants.items()
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
                json_files.write(done, _figures(folder, described.evaluated))
            figures, floor = json_files.read(done)
            every.setdefault(variant, []).append(figures)
    every |= {tables.FLOOR: [floor]} if floor else {}
    if only is None:
        json_files.write(Path(out) / "study.json", every)
    return every


def _common(scene: str, folder: Path, settings: Settings | None) -> Path | None:
    """Where the run that others begin with lies, trained to its end; None of None."""
    from terms import TERMS

    from gsjax import pipeline

    if settings is None:
        return None
    name = hashlib.sha256(json.dumps(config.to_dict(settings), sort_keys=True).encode()).hexdigest()[:12]
    run = folder / name
    if not (run / "manifest.json").exists() or json_files.read(run / "manifest.json")["status"] != "done":
        pipeline.train(scene, run, settings, terms=TERMS, resume=run.exists())
    return run


def _trained(scene: str, folder: Path, settings: Settings, seconds: float | None, earlier: Path | None) -> None:
    from terms import TERMS

    from gsjax import pipeline, runs

    if seconds is not None and not folder.exists():
        settings, line = pipeline.budgeted(scene, {folder.name: settings}, seconds)
        print(f"budget: {line}", flush=True)
    elif seconds is not None:
        settings = config.parse(Settings, runs.read_settings(folder))
    pipeline.train(scene, folder, settings, terms=TERMS, resume=folder.exists(), earlier=earlier)


def _figures(folder: Path, options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A variant's figures, and those of the true mesh where there is one."""
    from gsjax import pipeline, runs

    figures = pipeline.evaluate(folder, **options)
    last = runs.read_metrics(folder)[-20:]
    aligned = [1 - record["terms"]["sdf_normal"] for record in last if "sdf_normal" in record["terms"]]
    wanted = [*FIGURES, *(f"{score}_{way}" for score in ("psnr", "ssim") for way in WAYS)]
    scores, floor = ({key: f[key] for key in wanted if key in f} for f in (figures, figures.get("floor", {})))
    return scores | ({"mean_cos": np.mean(aligned)} if aligned else {}), floor


def _placed(value: Any, scene: str) -> Any:
    """`value` with "{scene}" in its strings replaced."""
    if isinstance(value, dict):
        return {key: _placed(item, scene) for key, item in value.items()}
    return value.replace("{scene}", scene) if isinstance(value, str) else value


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What a study is told, alone or in a sweep."""
    parser.add_argument("study", metavar="STUDY", help=", ".join(sorted(p.stem for p in STUDIES.glob("*.py"))))
    parser.add_argument("--scene", required=True, help="folder of the data set")
    parser.add_argument("--out", required=True, metavar="DIR", help="empty folder for the runs")
    parser.add_argument("--on", choices=CONFIGS, metavar="CONFIG", help="of configs.py (default: the study's own)")
    parser.add_argument("--seeds", type=parsers.count, default=1, metavar="N", help="runs of each variant (default: 1)")
    parser.add_argument("--budget", metavar="TIME", help="of every run, as in 10m (default: the study's steps)")


def main() -> None:
    """Reads the arguments and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(parser)
    parser.add_argument("--only", metavar="VARIANT_SEED", help="one run of them (default: all)")
    arguments = parser.parse_args()
    seconds = None if arguments.budget is None else parsers.seconds(arguments.budget)
    how = {"on": arguments.on, "seconds": seconds, "only": arguments.only}
    every = run(arguments.study, arguments.scene, arguments.out, arguments.seeds, **how)
    print(tables.compare({variant: tables.spread(rows) for variant, rows in every.items()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
