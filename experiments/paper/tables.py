"""The paper's three tables, with what the runs of a folder measured below what was published, as Markdown."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from paper.published import PUBLISHED, notes_of, source
from paper.scenes import BLENDING, INDOOR, OUTDOOR, SCENES, SCHEDULES, TANKS, parts

TABLES = {"Mip-NeRF 360": (INDOOR, OUTDOOR), "Tanks & Temples": (TANKS,), "Deep Blending": (BLENDING,)}
KINDS = {"coarse": "Gaussians", "refined": "refined"}
"""What is scored: the Gaussians of the training, and those bound to the refined mesh (as SuGaR's tables)."""
LPIPS = "lpips_vgg_3dgs"  # Pictures fed in 0..1, as the code behind the published figures does.
SQUEEZE = "lpips_squeeze"  # LPIPS of SqueezeNet, which no published row has.
METRICS = {"psnr": ("PSNR", 2), "ssim": ("SSIM", 3), LPIPS: ("LPIPS", 3), SQUEEZE: ("LPIPS, SqueezeNet", 3)}
"""Figure of a run -> heading, and digits. The published rows have all but the last."""
COLUMNS = ("Method", *(heading for heading, _ in METRICS.values()), "Scenes", "Seeds", "Source")
DASH = "-"


class RunScore(NamedTuple):
    """The scores of one run."""

    scene: str
    method: str
    seed: int
    figures: Mapping[str, Any]  # by the names of `METRICS`; None or absent where there is none


class Row(NamedTuple):
    """One line of a table."""

    cells: tuple[str, ...]  # of `COLUMNS`
    notes: Sequence[str] = ()


def methods(schedules: Iterable[str]) -> list[str]:
    """The names of all rows that schedules make, in the order of `SCHEDULES`."""
    selection = set(schedules)
    return [
        _method_name(name, kind)
        for name, schedule in SCHEDULES.items()
        if name in selection
        for kind in KINDS
        if kind == "coarse" or schedule.refinement
    ]


def _method_name(schedule: str, kind: str) -> str:
    return f"gsjax {schedule}, {KINDS[kind]}"


def run_folder(out: str | Path, scene: str, schedule: str, seed: int) -> Path:
    """Where a run is."""
    return Path(out) / scene / f"{schedule}_{seed}"


def run_results(out: str | Path) -> list[tuple[str, str, int, dict[str, Any]]]:
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
        RunScore(scene, _method_name(schedule, kind), seed, result[kind])
        for scene, schedule, seed, result in results
        for kind in KINDS
        if kind in result
    ]


def markdown(measured: Sequence[RunScore], methods: Sequence[str], remarks: Mapping[str, str]) -> str:
    """The three tables, each with its notes below: every part of a table, then every scene.

    Args:
        measured: All scores there are.
        methods: Names of the measured rows; one without scores has dashes.
        remarks: What there is to say about a scene's runs, by the scene's name.
    """
    lines = []
    for title, own in TABLES.items():
        notes: dict[str, int] = {}  # numbered in the order in which they appear
        lines += [f"## {title}", ""]
        blocks = {part: parts()[part] for part in own} | {scene: (scene,) for part in own for scene in parts()[part]}
        for name, scenes in blocks.items():
            lines += [f"### {name}", "", _piped(COLUMNS), _piped(["---"] * len(COLUMNS))]
            rows = [_published_row(name, method) for method in PUBLISHED.get(name, ())]
            for (method, *cells), texts in [
                *rows,
                *(_measured_row(measured, each, scenes, remarks) for each in methods),
            ]:
                marks = ",".join(str(notes.setdefault(text, len(notes) + 1)) for text in texts)
                lines.append(_piped([f"{method} [{marks}]" if marks else method, *cells]))
            lines.append("")
        lines += [*(f"[{number}] {text}  " for text, number in notes.items()), ""]
    return "\n".join(lines)


def _published_row(part: str, method: str) -> Row:
    figures = zip(PUBLISHED[part][method], METRICS.values(), strict=False)
    cells = [f"{figure:.{digits}f}" for figure, (_, digits) in figures]
    return Row((method, *cells, DASH, str(len(parts()[part])), DASH, source(part, method)), notes_of(part, method))


def _measured_row(measured: Sequence[RunScore], method: str, scenes: Sequence[str], remarks: Mapping[str, str]) -> Row:
    """A method over those of the scenes that were measured: means over seeds, then over scenes."""
    scores = {
        scene: {m.seed: m.figures for m in measured if (m.method, m.scene) == (method, scene)} for scene in scenes
    }
    scores = {scene: by_seed for scene, by_seed in scores.items() if by_seed}
    counts = sorted({len(by_seed) for by_seed in scores.values()})
    named = f" ({', '.join(scores)})" if 0 < len(scores) < len(scenes) else ""
    over = str(len(scenes)) if len(scores) == len(scenes) else f"{len(scores)} of {len(scenes)}{named}"
    seeds = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1]))) if counts else DASH
    cells = [_mean(list(scores.values()), name, digits) for name, (_, digits) in METRICS.items()]
    notes = [remarks[scene] for scene in scores if scene in remarks]
    return Row((method, *cells, over, seeds, "measured" if scores else DASH), notes)


def _mean(scores: Sequence[Mapping[int, Mapping[str, Any]]], metric: str, digits: int) -> str:
    """The mean of the figures by scene and seed, and the standard deviation over the seeds that every scene has.

    A dash unless every one of the scenes has a figure: a mean must say what it is over.
    """
    figures = [
        {seed: each[metric] for seed, each in by_seed.items() if each.get(metric) is not None} for by_seed in scores
    ]
    if not figures or not all(figures):
        return DASH
    mean = np.mean([np.mean(list(by_seed.values())) for by_seed in figures])
    shared = set.intersection(*map(set, figures))
    per_seed = [np.mean([by_seed[seed] for by_seed in figures]) for seed in shared]
    return f"{mean:.{digits}f}" + (f" ± {np.std(per_seed, ddof=1):.{digits}f}" if len(shared) > 1 else "")


def _piped(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"
