"""How do the variants of a study compare, trained on one scene with the same seeds?

    python experiments/compare.py STUDY --scene PATH --out DIR [--on CONFIG] [--seeds N] [--record]

Called again it resumes where it was stopped. Prints the table of the page; with --record the figures become
`results/STUDY.json`.
"""

import argparse
import runpy
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import records
from configs import CONFIGS
from train import claim, load_config, nearest

from gsjax import config
from gsjax.cli import parsers, run_guarded
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.report import tables
from gsjax.settings import Settings

STUDIES = Path(__file__).parent / "studies"
COLUMNS = {  # of a page's table: title, factor, digits
    "psnr": ("PSNR, dB", 1, 2),
    "normal_error_deg": ("Normals, objects", 1, 1),
    "normal_error_all_deg": ("all", 1, 1),
    "chamfer": ("Chamfer, 1e-3", 1e3, 2),
    "processor_seconds": ("Processor seconds", 1, 0),
}


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
    """Figures of every variant, a row for each of the seeds 0, 1, ..., and the true mesh's own.

    A run that is done (`OUT/VARIANT_SEED/study.json`) is not done again, one that was stopped resumes.

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
    """The processor's seconds without compilations, which depend less on other programs than those of the clock."""
    from terms import terms_of_scene

    from gsjax import pipeline, runs

    terms = terms_of_scene(scene, settings)
    begin = time.process_time()
    pipeline.train(scene, folder, settings, terms=terms, resume=folder.exists())
    compiled = sum(each["seconds"] for step in runs.read_metrics(folder) for each in step.get("compiled", ()))
    return time.process_time() - begin - compiled


def _figures(folder: Path, points: int | None) -> tuple[dict[str, Any], dict[str, Any]]:
    """A variant's figures, and those of the true mesh where there is one."""
    from gsjax import pipeline, runs

    if points is not None:
        pipeline.mesh(folder, folder / "mesh.ply", points=points)
    figures = pipeline.evaluate(folder)
    last = runs.read_metrics(folder)[-20:]
    aligned = [1 - record["terms"]["sdf_normal"] for record in last if "sdf_normal" in record["terms"]]
    scores, floor = (
        {key: value for key, value in each.items() if isinstance(value, int | float)}
        for each in (figures, figures.get("floor", {}))
    )
    return scores | ({"mean_cos": np.mean(aligned)} if aligned else {}), floor


def _placed(value: Any, scene: str) -> Any:
    """`value` with "{scene}" in its strings replaced."""
    if isinstance(value, dict):
        return {key: _placed(item, scene) for key, item in value.items()}
    return value.replace("{scene}", scene) if isinstance(value, str) else value


def page_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: a line a variant, means over seeds and half of the range, and the time in percent of the first's."""
    columns = {key: column for key, column in COLUMNS.items() if key in rows[0]}
    lines = [["", *(title for title, *_ in columns.values()), "Time"], ["---"] * (len(columns) + 2)]
    whole = _seconds([row for row in rows if row["variant"] == rows[0]["variant"]])
    for name in dict.fromkeys(row["variant"] for row in rows):
        cells, each = [], [row for row in rows if row["variant"] == name]
        for key, (_, factor, digits) in columns.items():
            values = factor * np.array([row[key] for row in each if key in row])
            half = f" +-{np.ptp(values) / 2:.{digits}f}" if len(values) > 1 else ""
            cells.append(f"{values.mean():.{digits}f}{half}" if len(values) else "")
        lines.append([name, *cells, f"{100 * _seconds(each) / whole:.0f} %" if _seconds(each) else ""])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _seconds(rows: Sequence[Mapping[str, Any]]) -> float:
    return float(np.mean([row.get("processor_seconds", 0) for row in rows]))


def main() -> None:
    """Reads the arguments and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", metavar="STUDY", help=", ".join(sorted(p.stem for p in STUDIES.glob("*.py"))))
    parser.add_argument("--scene", required=True, help="folder of the data set")
    parser.add_argument("--out", required=True, metavar="DIR", help="empty folder for the runs")
    parser.add_argument("--on", choices=CONFIGS, metavar="CONFIG", help="of configs.py (default: the study's own)")
    parser.add_argument("--seeds", type=parsers.count, default=1, metavar="N", help="runs of each variant (default: 1)")
    parser.add_argument("--record", action="store_true", help="write results/STUDY.json")
    arguments = parser.parse_args()
    every = run(arguments.study, arguments.scene, arguments.out, arguments.seeds, on=arguments.on)
    rows = [{"variant": name} | row for name, each in every.items() for row in each]
    table = page_table(rows)
    if arguments.record:
        records.write(arguments.study, rows, table)
    print(table)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
