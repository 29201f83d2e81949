"""How do the variants of a study compare, trained on one scene with the same seeds?

    python experiments/compare.py STUDY --scene PATH --out DIR [--on CONFIG] [--seeds N]

Variants run for the steps of the study. Called again it resumes where it was stopped.
"""

import argparse
import runpy
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from configs import CONFIGS
from train import claim, load_config, nearest

from gsjax import config
from gsjax.cli import parsers, run_guarded
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.report import tables
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
    points: int | None  # surface points of each run's mesh; None: the number of `gsjax mesh`


def load_study(name: str, on: str | None = None) -> Study:
    """A study of `studies/NAME.py` on a config; None: on the study's own, `ON`.

    Its `variants(config, on)` returns the differences from that config; "{scene}" in them stands for the data set.

    Raises:
        InputError: There is no such study, or no such config.
    """
    path = STUDIES / f"{name}.py"
    if not path.is_file():
        raise InputError(f"no study '{name}'; the nearest is '{nearest(name, (p.stem for p in STUDIES.glob('*.py')))}'")
    module = runpy.run_path(str(path))
    on = on or module["ON"]
    base = load_config(on)
    return Study(on, base, module["variants"](base, on), module.get("POINTS"))


def run(study: str, scene: str, out: str, seeds: int = 1, *, on: str | None = None) -> dict[str, list[dict[str, Any]]]:
    """Figures of every variant, a row a seed, and the true mesh's own; also written to `OUT/study.json`.

    A run that is done (`OUT/VARIANT_SEED/study.json`) is not done again, one that was stopped resumes.

    Args:
        study: As in `load_study`.
        scene: Data set; "{scene}" in a value of the study stands for it.
        out: Folder for the runs, OUT/VARIANT_SEED each.
        seeds: Runs of every variant, with seeds 0, 1, ...
        on: Name of a config; None: the study's own.

    Raises:
        InputError: There is no such study, `out` holds runs of another, or one of its runs cannot be made.
    """
    described = load_study(study, on)
    claim(Path(out), {"study": study, "on": described.on, "scene": str(Path(scene).resolve())})
    every: dict[str, list[dict[str, Any]]] = {}
    floor: dict[str, Any] = {}
    for seed in range(seeds):
        for variant, change in described.variants.items():
            folder = Path(out) / f"{variant}_{seed}"
            done = folder / "study.json"
            if not done.exists():
                print(f"== {folder.name}", flush=True)
                settings = config.merge(described.config, _placed(change, scene), {"seed": seed})
                used = _train(scene, folder, config.parse(Settings, settings, where=variant))
                figures, floor = _figures(folder, described.points)
                json_files.write(done, (figures | {"processor_seconds": used}, floor))
            figures, floor = json_files.read(done)
            every.setdefault(variant, []).append(figures)
    every |= {tables.FLOOR: [floor]} if floor else {}
    json_files.write(Path(out) / "study.json", every)
    return every


def _train(scene: str, folder: Path, settings: Settings) -> float:
    """The seconds of the processor, which depend less on other processes than those of the clock."""
    from terms import terms_of_scene

    from gsjax import pipeline

    terms = terms_of_scene(scene, settings)
    begin = time.process_time()
    pipeline.train(scene, folder, settings, terms=terms, resume=folder.exists())
    return time.process_time() - begin


def _figures(folder: Path, points: int | None) -> tuple[dict[str, Any], dict[str, Any]]:
    """A variant's figures, and those of the true mesh where there is one."""
    from gsjax import pipeline, runs

    if points is not None:
        pipeline.mesh(folder, folder / "mesh.ply", points=points)
    figures = pipeline.evaluate(folder)
    last = runs.read_metrics(folder)[-20:]
    aligned = [1 - record["terms"]["sdf_normal"] for record in last if "sdf_normal" in record["terms"]]
    keys = [*FIGURES, *(f"{score}_{way}" for score in ("psnr", "ssim") for way in WAYS)]
    scores, floor = ({key: f[key] for key in keys if key in f} for f in (figures, figures.get("floor", {})))
    return scores | ({"mean_cos": np.mean(aligned)} if aligned else {}), floor


def _placed(value: Any, scene: str) -> Any:
    """`value` with "{scene}" in its strings replaced."""
    if isinstance(value, dict):
        return {key: _placed(item, scene) for key, item in value.items()}
    return value.replace("{scene}", scene) if isinstance(value, str) else value


def spread(rows: Sequence[Mapping[str, float]]) -> dict[str, str]:
    """Mean of every quantity over rows that all have it, a row a seed; where they are several also least and most."""
    columns = {name: np.array([row[name] for row in rows], float) for name in rows[0]}
    texts = {
        name: [tables.format_value(float(v)) for v in (each.mean(), each.min(), each.max())]
        for name, each in columns.items()
    }
    return {name: f"{mean} [{least} {most}]" if len(rows) > 1 else mean for name, (mean, least, most) in texts.items()}


def main() -> None:
    """Reads the arguments and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", metavar="STUDY", help=", ".join(sorted(p.stem for p in STUDIES.glob("*.py"))))
    parser.add_argument("--scene", required=True, help="folder of the data set")
    parser.add_argument("--out", required=True, metavar="DIR", help="empty folder for the runs")
    parser.add_argument("--on", choices=CONFIGS, metavar="CONFIG", help="of configs.py (default: the study's own)")
    parser.add_argument("--seeds", type=parsers.count, default=1, metavar="N", help="runs of each variant (default: 1)")
    arguments = parser.parse_args()
    every = run(arguments.study, arguments.scene, arguments.out, arguments.seeds, on=arguments.on)
    print(tables.compare({variant: spread(rows) for variant, rows in every.items()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
