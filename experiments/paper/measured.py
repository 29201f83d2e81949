"""What the runs of a folder measured: of every scene, and averaged over scenes with the spread over seeds."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from paper import published
from paper.scenes import SCENES, SCHEDULES

KINDS = {"coarse": "Gaussians", "refined": "refined"}
"""What is scored: the Gaussians of the training, and those bound to the refined mesh (as SuGaR's tables)."""
METRICS = (*published.METRICS, "squeeze")
LPIPS = "lpips_vgg_3dgs"  # Pictures fed in 0..1, as the code behind the published figures does.
SQUEEZE = "lpips_squeeze"  # LPIPS of SqueezeNet, which no published row has.


class RunScore(NamedTuple):
    """The scores of one run; None where there is none."""

    scene: str
    method: str
    seed: int
    psnr: float | None
    ssim: float | None
    lpips: float | None
    gaussians: int | None
    squeeze: float | None = None


class Value(NamedTuple):
    """A mean, and its standard deviation over seeds where there are several."""

    mean: float
    spread: float | None


class Average(NamedTuple):
    """A measured row."""

    values: dict[str, Value | None]  # by metric
    scenes: tuple[str, ...]  # that it is over
    seeds: tuple[int, int]  # fewest and most of a scene


def method_name(schedule: str, kind: str) -> str:
    """The name of a measured row."""
    return f"gsjax {schedule}, {KINDS[kind]}"


def methods(schedules: Iterable[str]) -> list[str]:
    """The names of all rows that schedules make, in the order of `SCHEDULES`."""
    selection = set(schedules)
    return [
        method_name(name, kind)
        for name, schedule in SCHEDULES.items()
        if name in selection
        for kind in KINDS
        if kind == "coarse" or schedule.refinement
    ]


def run_folder(out: str | Path, scene: str, schedule: str, seed: int) -> Path:
    """Where a run is."""
    return Path(out) / scene / f"{schedule}_{seed}"


def found_runs(out: str | Path) -> list[tuple[str, str, int, dict[str, Any]]]:
    """Scene, schedule, seed and result of every run that has one, finished or not."""
    from gsjax.io import json_files

    results = []
    for scene in SCENES:
        for file in sorted((Path(out) / scene).glob("*/result.json")):
            schedule, _, seed = file.parent.name.rpartition("_")
            if schedule in SCHEDULES and seed.isdecimal():
                results.append((scene, schedule, int(seed), json_files.read(file)))
    return results


def measurements(results: Iterable[tuple[str, str, int, dict[str, Any]]]) -> list[RunScore]:
    """The scores in the results of runs."""
    return [
        RunScore(
            scene,
            method_name(schedule, kind),
            seed,
            *(result[kind].get(k) for k in ("psnr", "ssim", LPIPS, "gaussians", SQUEEZE)),
        )  # fmt: skip
        for scene, schedule, seed, result in results
        for kind in KINDS
        if kind in result
    ]


def average(measured: Sequence[RunScore], method: str, scenes: Sequence[str]) -> Average:
    """A method's row over those of the scenes that were measured: means over seeds, then over scenes.

    The spread is the standard deviation of the scenes' mean over the seeds that every one of them has.
    """
    rows = [m for m in measured if m.method == method and m.scene in scenes]
    present = tuple(scene for scene in scenes if any(m.scene == scene for m in rows))
    counts = [len({m.seed for m in rows if m.scene == scene}) for scene in present] or [0]
    values = {metric: _value(rows, metric, present) for metric in METRICS}
    return Average(values, present, (min(counts), max(counts)))


def _value(rows: Sequence[RunScore], metric: str, scenes: Sequence[str]) -> Value | None:
    """None unless every one of the scenes has a figure: a mean must say what it is over."""
    figures = {
        scene: {m.seed: getattr(m, metric) for m in rows if m.scene == scene and getattr(m, metric) is not None}
        for scene in scenes
    }
    if not figures or not all(figures.values()):
        return None
    mean = float(np.mean([np.mean(list(of_seeds.values())) for of_seeds in figures.values()]))
    shared = set.intersection(*(set(of_seeds) for of_seeds in figures.values()))
    per_seed = [np.mean([of_seeds[seed] for of_seeds in figures.values()]) for seed in sorted(shared)]
    return Value(mean, float(np.std(per_seed, ddof=1)) if len(per_seed) > 1 else None)
