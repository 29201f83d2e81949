"""What does one run of the paper's protocol reach on one scene? Trains, meshes, textures, draws, refines and scores.

    python experiments/paper_run.py SCENE DATA OUT [--schedule NAME] [--seed N]

Resumes where it stopped. `reproduce.py` does all of them.
"""

import argparse
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from paper.scenes import PAPER_MESH, SCENES, SCHEDULES, settings_of
from paper.tables import METRICS

from gsjax import config
from gsjax.cli import run_guarded
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.report import tables
from gsjax.settings import PLAIN, Phase, Settings

STAGES = ("train", "coarse", "mesh", "texture", "sheet", "refine", "refined")
SCORES = (*METRICS, "gaussians", "views")


def run_settings(scene: str, schedule: str, seed: int, assignments: Sequence[str], refinement: Sequence[str]) -> dict:
    """What a run is to do, as plain data: `settings` of the training, `refinement` (None: without), of the `mesh`.

    Raises:
        InputError: An assignment is wrong.
    """
    from gsjax.binding.refinement import PRESETS, Refinement

    preset, refined = SCHEDULES[schedule].refinement, None
    if preset:
        # The published rows are of Gaussians on the mesh alone.
        options = {**PRESETS[preset], "seed": seed, "keep_free": False}
        whole = config.to_dict(config.parse(Refinement, options))
        refined = config.to_dict(config.parse(Refinement, config.override(whole, refinement), where="--refine"))
    settings = config.to_dict(settings_of(scene, schedule, seed, assignments))
    return {"settings": settings, "refinement": refined, "mesh": dict(PAPER_MESH)}


def read_result(folder: Path, wishes: Mapping[str, Any], lpips: Sequence[str] = ()) -> dict[str, Any]:
    """The result so far of a run; scores without the given weights of LPIPS are taken out.

    Raises:
        InputError: It was begun with other wishes.
    """
    file = folder / "result.json"
    if not file.exists():
        return {"asked": dict(wishes)}
    result = json_files.read(file)
    for part, wish in wishes.items():
        before = result["asked"].get(part) or {}
        for key, value in (wish or {}).items():
            if before.get(key) != value:
                raise InputError(f"{folder}: was begun with another {part}.{key}; choose another folder with --out")
    if lpips and result.get("lpips") != list(lpips):
        result = {key: value for key, value in result.items() if key not in ("coarse", "refined")}
    return result


def is_finished(result: Mapping[str, Any]) -> bool:
    """Whether there is nothing left to do."""
    return all(stage in result for stage in _stage_names(result["asked"]))


def run(
    scene: str,
    data: Path,
    out: Path,
    *,
    schedule: str,
    seed: int,
    assignments: Sequence[str] = (),
    refinement: Sequence[str] = (),
    lpips: Sequence[str] = (),
) -> dict[str, Any]:
    """Every stage that is not done yet; OUT/result.json is written after each.

    Args:
        scene: A name of `SCENES`.
        data: Its folder.
        out: Folder of the run: `run/`, `run/mesh.ply`, `refined/`, `before.ply` (the Gaussians as the phase with
            the regulariser found them), `textured.glb`, `sheet.png`, `result.json`.
        schedule: A name of `SCHEDULES`.
        seed: Of training and refinement.
        assignments: key=value of the training.
        refinement: key=value of the refinement.
        lpips: Files of weights.

    Raises:
        InputError: A stage cannot be done, or `out` was begun with other settings.
    """
    from gsjax.io.machine import machine, versions

    wishes = run_settings(scene, schedule, seed, assignments, refinement)
    result = read_result(out, wishes, lpips)
    stages = _stages(data, out, wishes, lpips, SCHEDULES[schedule].regulariser)
    for name in _stage_names(wishes):
        if name not in result:
            print(f"== {scene}, {schedule}, seed {seed}: {name}", flush=True)
            result[name] = stages[name]()
            result |= {"lpips": list(lpips), "machine": machine(), "versions": versions()}
            json_files.write(out / "result.json", result)
    return result


def _stage_names(wishes: Mapping[str, Any]) -> tuple[str, ...]:
    return STAGES if wishes["refinement"] else STAGES[: STAGES.index("texture")]


def _stages(
    data: Path, out: Path, wishes: Mapping[str, Any], lpips: Sequence[str], regulariser: str | None
) -> dict[str, Callable[[], Any]]:
    from paper.sheet import draw_sheet

    from gsjax import pipeline
    from gsjax.binding.refinement import Refinement

    trained, refined = out / "run", out / "refined"
    return {
        "train": lambda: _train(data, trained, config.parse(Settings, wishes["settings"])),
        "coarse": lambda: _scores(trained, lpips),
        "mesh": lambda: pipeline.mesh(trained, trained / "mesh.ply", **wishes["mesh"]),
        "texture": lambda: pipeline.texture(trained, trained / "mesh.ply", out / "textured.glb"),
        "sheet": lambda: draw_sheet(out, str(regulariser)),
        "refine": lambda: pipeline.refine(
            trained, refined, config.parse(Refinement, wishes["refinement"]), resume=_goes_on(refined)
        ),
        "refined": lambda: _scores(refined, lpips),
    }


def _train(data: Path, folder: Path, settings: Settings) -> dict[str, Any]:
    from terms import terms_of_scene

    from gsjax import pipeline, runs

    before = folder.parent / "before.ply"
    keep, goes_on = partial(_keep_before, before, settings), _goes_on(folder)
    terms = terms_of_scene(data, settings)
    summary = pipeline.train(data, folder, settings, terms=terms, resume=goes_on, observe=keep)
    most = max((record["gaussians"] for record in runs.read_metrics(folder) if "gaussians" in record), default=0)
    cap = {
        "most_gaussians": most,
        "max_gaussians": settings.model.max_gaussians,
        "cap_bound": most >= settings.model.max_gaussians,
    }
    if cap["cap_bound"]:
        print(f"paper_run: {folder}: limited to max_gaussians={settings.model.max_gaussians:,}", file=sys.stderr)
    return {**summary, **cap, "normals": json_files.read(folder / "config.json")["supervision"]["normals"]}


def _keep_before(file: Path, settings: Settings, progress: Any) -> None:
    """Writes the Gaussians at the end of the phase before the first with a regulariser."""
    from gsjax.io.ply import write_gaussians

    if progress.phase_done and progress.step == _regularised_from(settings):
        write_gaussians(file, progress.state.gaussians.alive())


def _regularised_from(settings: Settings) -> int:
    """Steps before the first phase with a regulariser; 0 where there is none, or no phase before it."""
    if settings.schedule.vanilla:
        return 0
    first = next((i for i, phase in enumerate(settings.schedule.phases) if _is_regularised(phase)), 0)
    return sum(phase.steps for phase in settings.schedule.phases[:first])


def _is_regularised(phase: Phase) -> bool:
    return any(weight and name not in {*PLAIN, "entropy"} for name, weight in phase.weights.items())


def _goes_on(folder: Path) -> bool:
    """Whether a run folder can be continued; one that was stopped before it had a manifest makes room for another."""
    if folder.exists() and not (folder / "manifest.json").exists():
        shutil.rmtree(folder)
    return folder.exists()


def _scores(folder: Path, lpips: Sequence[str]) -> dict[str, Any]:
    from gsjax import pipeline

    figures = pipeline.evaluate(folder, lpips=lpips)
    return {key: figures.get(key) for key in SCORES}


def main() -> None:
    """Reads the arguments and prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("scene", choices=SCENES, metavar="SCENE", help=f"one of {', '.join(SCENES)}")
    add("data", type=Path, metavar="DATA", help="its folder")
    add("out", type=Path, metavar="OUT", help="folder of the run")
    add("--schedule", choices=SCHEDULES, default="paper_6k_15k", help="default: paper_6k_15k")
    add("--seed", type=int, default=0, metavar="N", help="seed of all random numbers (default: 0)")
    add("--set", nargs="+", default=[], metavar="KEY=VALUE", help="settings of the training by their dotted keys")
    add("--refine", nargs="+", default=[], metavar="KEY=VALUE", help="settings of the refinement")
    add("--lpips", action="append", default=[], metavar="FILE", help="weights of LPIPS, as for `gsjax eval`")
    a = parser.parse_args()
    result = run(a.scene, a.data, a.out, schedule=a.schedule, seed=a.seed, assignments=a.set, refinement=a.refine,
                 lpips=a.lpips)  # fmt: skip
    print(tables.record({kind: result[kind] for kind in ("coarse", "refined") if kind in result}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
