"""Which effects does training find and undo? Each is put into the built-in scene, at several strengths and not at all.

    python experiments/effect_recovery.py --out DIR [--effects NAME ...] [--views N] [--size N] [--steps N] [--seeds N]

Every effect and strength is one row: what `train --effects auto` decides, how far off the parameters that it learns
are, and PSNR and Chamfer distance of a run that ignores it and of one that simulates it. In the row of strength 0 the
latter is forced on. PSNR is that of the held-out photos as they were before anything was put in, from where they were
truly taken: both runs are asked for the same pictures. `DIR/effect_recovery.md` is the table, `effect_recovery.json`
beside it holds its figures. Called again it does what is left.
"""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from inject_effects import inject

from gsjax import config, tables
from gsjax.cli import run_guarded
from gsjax.cli.parsers import count
from gsjax.io import json_files
from gsjax.io.machine import machine
from gsjax.settings import Settings

if TYPE_CHECKING:  # They import jax.
    from effect_errors import Truth

FIRST = 20  # steps that are not timed: they compile
NAMES = "ignored", "simulated"


@dataclass(frozen=True)
class Case:
    """An effect that is put in."""

    strengths: tuple[float, ...]  # beside none
    put_in: Callable[[float], dict[str, float]]  # strength -> options of `inject_effects.inject`
    unit: str  # of the error of what a run learns of it, see `effect_errors.ERRORS`


CASES = {
    "exposure": Case((0.1, 0.3), lambda stops: {"exposure": stops, "balance": stops / 3}, "EV"),
    "vignetting": Case((0.2, 0.5), lambda stops: {"corner": -stops}, "EV"),
    "poses": Case((0.1, 0.3, 0.5), lambda degrees: {"turn": degrees, "shift": float(np.radians(degrees))}, "px"),
    "background": Case((0.5, 1.0), lambda share: {"sky": share}, "/255"),
    "transients": Case((0.3, 0.6), lambda share: {"pasted": share}, "of pixels"),
}
"""Strengths: EV over the photos (a third of it in every channel); EV at a corner; degrees about each axis, and as many
radians of the distance along it; how far what is behind goes from white to a sky; share of the photos with squares."""


def settings(effects: str, steps: int, gaussians: int, seed: int, background: str) -> Settings:
    """A short run of the photometric loss."""
    return config.parse(
        Settings,
        {
            "seed": seed,
            "effects": effects,
            "background": background,
            "max_gaussians": gaussians,
            "sh_degree": 1,
            "sh_every": max(steps // 3, 1),
            "phases": [{"name": "vanilla", "steps": steps, "density_control": True}],
            "density": {"rule": "error", "start": steps // 10, "stop": steps // 2, "every": 50, "reset_every": 0},
            "logging": {"metrics_every": 100, "evaluate_every": 0, "checkpoint_every": max(steps, 1)},
        },
    )


def trained(scene: Path, run: Path, chosen: Settings) -> float:
    """Trains unless that was done; median processor seconds of a step."""
    from gsjax import pipeline

    if not (run / "timed.json").exists():
        times: list[float] = []
        resume = (run / "config.json").exists()
        pipeline.train(scene, run, chosen, resume=resume, observe=lambda _: times.append(time.process_time()))
        json_files.write(run / "timed.json", {"seconds_per_step": float(np.median(np.diff(times)[FIRST:]))})
    return json_files.read(run / "timed.json")["seconds_per_step"]


def scored(truth: "Truth", background: str, *, aligned: bool) -> dict[str, Any]:
    """PSNR of the true held-out photos, from where they were taken and from where they fit best; Chamfer distance."""
    from gsjax import pipeline
    from gsjax.effects.alignment import align
    from gsjax.meshing.export import read_mesh
    from gsjax.pipeline.evaluate import score_mesh
    from gsjax.runs.photography import Photography, read_photography, with_moved_cameras
    from gsjax.runs.result import open_result
    from gsjax.scoring.images import score_images

    file = truth.run / f"scored{'_aligned' if aligned else ''}.json"
    if not file.exists():
        result, found = open_result(truth.run), read_photography(truth.run)
        photos = truth.scene if truth.told.get("sky") else truth.clean
        true = {frame.name: frame.viewmat for frame in truth.clean.frames}
        frames = [replace(frame, viewmat=true[frame.name]) for frame in photos.held_out_frames]
        scores = score_images(
            result.gaussians,
            with_moved_cameras(tuple(frames), found.moves),
            background,
            found=Photography(background=found.background),
            align=align if aligned else None,
        )
        mesh = truth.run / "mesh.ply"
        pipeline.mesh(truth.run, mesh, points=100_000, depth=7)
        known = truth.clean.truth
        assert known is not None and known.mesh is not None, "built in"
        assert known.points is not None and known.point_normals is not None, "built in"
        scores |= score_mesh(read_mesh(mesh), known.points, known.point_normals, read_mesh(known.mesh))
        names = ("psnr", "psnr_aligned", "chamfer")
        json_files.write(file, {name: scores.get(name) for name in names})
    return json_files.read(file)


def row(out: Path, clean: Path, effect: str, strength: float, given: argparse.Namespace, seed: int) -> dict[str, Any]:
    """One effect at one strength: decision, and scores of both runs."""
    from effect_errors import ERRORS, Truth

    from gsjax.io.scenes import load_scene
    from gsjax.planning.effect_validation import EffectValidation
    from gsjax.planning.effects import choose_effects
    from gsjax.planning.sizes import training_extent
    from gsjax.planning.start import first_state
    from gsjax.training.plan import plan

    case, scene = CASES[effect], clean
    if strength:
        scene = out / f"{effect}_{strength:g}"
        if not scene.exists():
            inject(clean, scene, **case.put_in(strength))
    told = json_files.read(scene / "injected.json") if strength else {}
    # A sky is not known to whoever starts a run; the clean scene's white is.
    background = "black" if effect == "background" and strength else "white"
    chosen = [settings(e, given.steps, given.gaussians, seed, background) for e in ("auto", "none", effect)]
    before, after = load_scene(clean), load_scene(scene)
    planned = plan(chosen[0])
    validate = EffectValidation(
        chosen[0],
        planned,
        after.train_frames,
        training_extent(after),
        len(after.points),
        lambda short, optimizer, effects, skies: first_state(after, short, optimizer, effects, skies=skies),
    )
    by_auto = choose_effects("auto", planned, after, validate).evidence
    assert by_auto is not None, "auto looks"
    evidence = by_auto["evidence"][effect]
    said = {(True, True): "hit", (True, False): "miss", (False, True): "false alarm", (False, False): "right"}
    figures = {
        "effect": effect,
        "strength": strength,
        "evidence": evidence["evidence"],
        "decision": said[strength > 0, effect in by_auto["simulated"]],
        "seed": seed,
    }
    for name, effects in zip(NAMES, chosen[1:], strict=True):
        run = out / f"run_{scene.name}_{effects.effects}_{background}_{seed}"
        seconds, truth = trained(scene, run, effects), Truth(before, after, told, run)
        scores = scored(truth, background, aligned=effect == "poses") | {"error": ERRORS[effect](truth)}
        figures |= {f"{key}, {name}": value for key, value in scores.items()}
        figures[f"ms a step, {name}"] = 1e3 * seconds
    return figures


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown, a row an effect and strength: means over the seeds, of several also the least and the most PSNR."""
    keys = ("psnr", "psnr_aligned", "chamfer", "error", "ms a step")
    heads = ["effect", "put in", "evidence", "decision", *(f"{k}: ignored, simulated" for k in keys)]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for effect, strength in dict.fromkeys((row["effect"], row["strength"]) for row in rows):
        seeds = [row for row in rows if (row["effect"], row["strength"]) == (effect, strength)]
        pairs = [", ".join(_pooled([row[f"{k}, {name}"] for row in seeds], k) for name in NAMES) for k in keys]
        pairs[3] += f" {CASES[effect].unit}"
        said = ", ".join(dict.fromkeys(row["decision"] for row in seeds))
        evidence = tables.format_value(float(np.mean([row["evidence"] for row in seeds])))
        lines.append("| " + " | ".join([f"`{effect}`", f"{strength:g}", evidence, said, *pairs]) + " |")
    return "\n".join(lines) + "\n"


def _pooled(values: list[float | None], key: str) -> str:
    found = [value for value in values if value is not None]
    if not found:
        return "-"
    mean = tables.format_value(float(np.mean(found)))
    return f"{mean} ({min(found):.2f}-{max(found):.2f})" if key == "psnr" and len(found) > 1 else mean


def main() -> None:
    """Reads the arguments, measures what is left and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for scenes, runs and table")
    parser.add_argument("--effects", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--views", type=int, default=32)
    parser.add_argument("--size", type=int, default=112)
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--gaussians", type=int, default=4000)
    parser.add_argument("--seeds", type=count, default=1)
    given = parser.parse_args()
    from gsjax.io import analytic_scene  # Here, and not above: it imports jax.

    clean = given.out / "clean"
    if not clean.exists():
        analytic_scene.write(clean, num_views=given.views, size=(given.size, given.size))
    rows: list[dict[str, Any]] = []
    for effect in given.effects:
        for strength in (0.0, *CASES[effect].strengths):
            rows += [row(given.out, clean, effect, strength, given, seed) for seed in range(given.seeds)]
            json_files.write(given.out / "effect_recovery.json", {"rows": rows, "machine": machine()})
            (given.out / "effect_recovery.md").write_text(table(rows))
    print(table(rows))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
