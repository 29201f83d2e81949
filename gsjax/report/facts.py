"""What the files of a run folder say, in the words and rows of its report."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np

from gsjax.io.json_shapes import check
from gsjax.report import tables
from gsjax.report.curves import Chart, Curve, chart
from gsjax.runs.records import FIGURES, WHOLE_MANIFEST
from gsjax.runs.run import Run

AXES = {"steps": "step", "seconds": "seconds"}  # Name of an axis, and what a line of metrics calls it.
CHARTS = {
    "Loss": {"loss": "loss"},
    "PSNR, dB": {
        "training view": "psnr",
        "held-out views": "held_out_psnr",
        "held-out views, exposed as photos near them": "held_out_psnr_near_gains",
    },
    "Gaussians": {"Gaussians": "gaussians"},
}
SPLITS = {"auto": "the data set's own split, else every 8th photo by name", "none": "requested: all photos train"}

REPORTED = {"photos": {"hold_out": str}, "seed": int, "refinement?": {"seed": int}}
LARGEST = 1e30  # that a chart can have on its axes

Rows = list[tuple[str, ...]]


@dataclass(frozen=True)
class RunFacts(Run):
    """One run folder, read for its report."""

    @classmethod
    def open(cls, folder: str | Path) -> Self:
        """The run in a folder, with the entries that a report requires; InputError where one is damaged."""
        run = super().open(folder)
        check(run.folder / "manifest.json", run.manifest, WHOLE_MANIFEST)
        check(run.folder / "config.json", run.settings, REPORTED)
        return run

    @cached_property
    def history(self) -> list[dict[str, Any]]:
        """The metrics, and the last score of the held-out views."""
        if not _has_numbers(self.manifest, "psnr", "steps", "train_seconds"):
            return self.metrics
        scores = {f"held_out_{n}": self.manifest[n] for n in ("psnr", "psnr_near_gains") if n in self.manifest}
        last = {"step": self.manifest["steps"], "seconds": self.manifest["train_seconds"], **scores}
        return [*self.metrics, last]

    @property
    def stages(self) -> dict[str, dict[str, Any]]:
        """Figures of every stage that this folder knows of, by name."""
        own = {name: self.manifest[name] for name in FIGURES if name in self.manifest}
        first = {**own, "seconds": self.manifest.get("train_seconds"), "peak_gib": self.manifest.get("peak_gib")}
        return {"refine" if self.is_refinement else "train": first, **self.manifest.get("stages", {})}


def what_was_read(run: RunFacts) -> Rows:
    """Return name and value of what the run read."""
    rows = [("Data set", run.manifest["scene"]), ("Photos", _photos(run)), ("Command", run.manifest["command"])]
    return [*rows, ("Started at", run.manifest["created"]), ("State", state(run))]


def what_was_decided(run: RunFacts) -> Rows:
    """Return what was decided, how, and why."""
    hold_out, factor = str(run.settings["photos"]["hold_out"]), run.downscale
    held_out = f"{sum(view['held_out'] for view in run.views)} of {len(run.views)}" if run.views else "not known yet"
    return [
        ("Size of the photos", f"reduced {factor:g} times" if factor > 1 else "as they are", _photos(run)),
        ("Photos for scoring", held_out, SPLITS.get(hold_out, f"requested: {hold_out}")),
        ("Normals", *_normals(run)),
        ("Effects of photography", *_effects(run)),
        *_dropout(run),
    ]


def _dropout(run: RunFacts) -> Rows:
    """A row where steps leave Gaussians out; plans of earlier versions have no such entry."""
    share = max((phase.get("dropout", 0.0) for phase in run.plan["phases"]), default=0.0)
    reason = "sparse-view regularization: few photos, or far apart"
    decision = run.manifest.get("sparse_views") or {}
    if decision.get("dropout_alone") and _has_numbers(decision, "degrees"):
        reason = f"a long run on {decision['photos']} photos that are {decision['degrees']:.0f} degrees apart"
    if run.settings["schedule"].get("dropout", 0.0):
        reason = f"requested: schedule.dropout={share:g}"
    return [("Left out of every step", f"{share:.0%} of the Gaussians", reason)] if share else []


def plan(run: RunFacts) -> Rows:
    """Phase, steps, and terms of the loss with their weights."""
    rows = []
    for phase in run.plan["phases"]:
        terms = ", ".join(f"{name} {weight:g}" for name, weight in phase["terms"].items())
        rows.append((phase["name"], f"{phase['steps']:,}", terms))
    return rows


def effects(run: RunFacts) -> Rows:
    """Effect, decision, evidence, noise, threshold, and what the note says; empty where no diagnosis was made."""
    record, rows = run.manifest.get("effects", {}), []
    for name, each in record.get("evidence", {}).items():
        decision = "simulated" if name in record["simulated"] else "detected" if each["on"] else "no"
        values = [each[key] for key in ("evidence", "noise", "threshold")]
        figures = (tables.format_value(v) + ("" if v is None else f" {each['unit']}".rstrip()) for v in values)
        rows.append((name, decision, *figures, each["note"]))
    return rows


def scores(run: RunFacts) -> Rows:
    """Name and value: of the end of the run, then of the last `gsjax eval`."""
    named = {name: value for name, value in run.manifest.items() if name.startswith(("psnr", "ssim"))}
    sizes = {name: run.manifest[name] for name in ("views", "gaussians", "vertices", "faces") if name in run.manifest}
    evaluated = run.manifest.get("stages", {}).get("eval", {})
    figures = {**named, **sizes, **{k: v for k, v in evaluated.items() if k not in ("seconds", "peak_gib")}}
    return [(name, tables.format_value(value)) for name, value in tables.flatten(figures)]


def stage_rows(stages: Mapping[str, Mapping[str, Any]]) -> Rows:
    """Stage, seconds, GiB, and what came of it."""
    rows = []
    for name, stage in stages.items():
        outcome = (f"{key} {tables.format_value(stage[key])}" for key in FIGURES if stage.get(key) is not None)
        costs = (tables.format_value(stage.get(key)) for key in ("seconds", "peak_gib"))
        rows.append((name, *costs, ", ".join(outcome)))
    return rows


def flat_settings(value: Any, at: str = "") -> dict[str, str]:
    """Every setting as JSON under its dotted key, as `--set` takes it."""
    if isinstance(value, list) and any(isinstance(item, Mapping) for item in value):
        value = dict(enumerate(value))
    if not isinstance(value, Mapping):
        return {at: json.dumps(value)}
    inner = [flat_settings(item, f"{at}.{name}".lstrip(".")) for name, item in value.items()]
    return {key: text for one in inner for key, text in one.items()}


def charts(
    pools: Mapping[str, Sequence[RunFacts]], axis: str, titles: Mapping[str, Mapping[str, str]] = CHARTS
) -> list[Chart]:
    """Curves against `axis`, "steps" or "seconds": the mean of the runs under each label.

    Lines are named after the labels where there are several, and phases marked where not. A title has names of lines,
    and what the metrics call them; the last line is the one that counts.
    """
    alone, figures = len(pools) == 1, []
    for title, lines in titles.items():
        curves = [
            Curve(name if alone else label, *pool_curves(pool, key, AXES[axis]), color, name != [*lines][-1])
            for color, (label, pool) in enumerate(pools.items())
            for name, key in lines.items()
        ]
        marks = phase_ends(next(iter(pools.values()))[0], AXES[axis]) if alone else []
        figures.append(chart(title, axis, curves, marks))
    return [each for each in figures if each]


def pool_curves(
    pool: Sequence[RunFacts], key: str, axis: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """The x and the mean y at the steps that all runs logged `key` at; of several runs also least and most."""
    logs = [
        {record["step"]: (record[axis], record[key]) for record in run.history if _has_numbers(record, key, axis)}
        for run in pool
    ]
    steps = sorted(set.intersection(*map(set, logs)))
    values = np.array([[one[step] for step in steps] for one in logs], float).reshape(len(logs), len(steps), 2)
    x, y = values.mean(0).T
    return (x, y, values[..., 1].min(0), values[..., 1].max(0)) if len(pool) > 1 else (x, y, None, None)


def phase_ends(run: RunFacts, axis: str) -> list[tuple[float, str]]:
    """Where, as far as was logged, each phase but the last ended, and its name."""
    logged = [record for record in run.history if "phase" in record and _has_numbers(record, axis)]
    pairs = pairwise(logged)
    return [(float(one[axis]), one["phase"]) for one, after in pairs if one["phase"] != after["phase"]]


def _has_numbers(record: Mapping[str, Any], *keys: str) -> bool:
    return all(isinstance(record.get(key), int | float) and abs(record[key]) < LARGEST for key in keys)


def _photos(run: RunFacts) -> str:
    if "photos" in run.manifest:
        return run.manifest["photos"]
    sizes = sorted({(view["width"], view["height"]) for view in run.views}, reverse=True)
    return f"{len(run.views)} photos at {sizes[0][0]}x{sizes[0][1]}" if sizes else "not known yet"


def state(run: RunFacts) -> str:
    """Return "done", or how many steps are logged."""
    if run.manifest["status"] == "done":
        return f"done, {run.manifest.get('updated', '')}".rstrip(", ")
    reached = run.history[-1]["step"] if run.history else 0
    return f"not finished: {reached:,} of {run.plan['steps']:,} steps logged"


def _normals(run: RunFacts) -> tuple[str, str]:
    if run.is_refinement or not any("normals" in phase["needs"] for phase in run.plan["phases"]):
        return "none", "no loss term needs them"
    if run.plan["normals"] is None and "stereo" in run.manifest:
        return "of multi-view stereo", run.manifest["stereo"]
    if run.plan["normals"] is None:
        why = "no maps were given (supervision.normals)"
        return "self-supervised, of the rendered depth, smoothed", run.manifest.get("normals", why)
    axes = run.settings["supervision"].get("normal_axes")
    note = f"axes requested: {axes}" if axes else "axes of the maps' maker, or found by comparison"
    return run.plan["normals"], run.manifest.get("normals", note)


def _effects(run: RunFacts) -> tuple[str, str]:
    if run.is_refinement and run.settings["effects"]["names"] != "none":
        return run.settings["effects"]["names"], "removed from the photos, as training estimated them"
    if "effects" not in run.manifest:
        return "none", "the photos were not diagnosed: effects.names=none"
    names = ", ".join(run.manifest["effects"]["simulated"]) or "none"
    request = run.settings["effects"]["names"]
    return names, "what the photos show, see below" if request == "auto" else f"requested: {request}"
