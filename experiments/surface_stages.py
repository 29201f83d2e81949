"""What do the surface phase and the refinement bring and cost, from photos to a mesh on one scene, over seeds?

    python experiments/surface_stages.py CONFIG --scene PATH --out DIR [--seeds N] [--refine KEY=VALUE ...]

Three ways: vanilla, surface, and surface then refined. Figures stand beside those of the true mesh.

Every stage runs in a process of its own, so that its seconds (loading and compilation included) and its peak memory are
its own. Prints a table of figures and one of stages; writes DIR/surface.json and DIR/surface.png. Called again it
goes on after the stages that are done (DIR/stages.json).
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from configs import CONFIGS
from train import load_settings

from gsjax import tables
from gsjax.cli import parsers, run_guarded
from gsjax.io import json_files
from gsjax.io.machine import peak_memory

WAYS = ("vanilla", "surface", "refined")
FIGURES = ("chamfer", "fscore", "fscore_half", "normal_consistency", "outward_share", "psnr", "ssim",
           "normal_error_deg", "normal_error_all_deg", "mesh_normal_error_deg",
           "mesh_normal_error_all_deg")  # fmt: skip
PICTURE_SIZE = 480


def run(name: str, scene: str, out: str, *, seeds: int = 3, refinement: Sequence[str] = ()) -> dict[str, Any]:
    """Figures of the three ways and of the true mesh over the seeds, and stages.

    Args:
        name: A config of `configs.py`; its normals are used, if it names any.
        scene: Data set with a true surface.
        out: Folder for the runs, OUT/WAY_SEED each.
        seeds: Runs of every way, with seeds 0, 1, ...
        refinement: key=value assignments to the refinement's "fast" settings.
    """
    figures: dict[str, list[dict]] = {way: [] for way in WAYS}
    stages: dict[str, list[dict]] = {}
    ledger = Path(out) / "stages.json"
    done = json_files.read(ledger) if ledger.exists() else {}
    for seed in range(seeds):
        folders = {way: Path(out) / f"{way}_{seed}" for way in WAYS}

        def staged(label: str, stage: Callable, *arguments: Any, seed: int = seed) -> Any:
            title = f"seed {seed}: {label}"
            if title not in done:
                print(f"== {title}", flush=True)
                result, cost = _alone(stage, *arguments)
                done[title] = {"result": result, "cost": cost}
                json_files.write(ledger, done)
            stages.setdefault(label, []).append(done[title]["cost"])
            return done[title]["result"]

        for way in ("vanilla", "surface"):
            staged(f"train {way}", _train, name, scene, folders[way], seed, way == "vanilla")
            staged(f"mesh {way}", _mesh, folders[way])
        staged("refine", _refine, folders["surface"], folders["refined"], seed, refinement)
        staged("texture refined", _texture, folders["refined"])
        for way in WAYS:
            scores, floor = staged(f"score {way}", _score, folders[way])
            figures[way].append(scores)
        figures[tables.FLOOR] = [floor] if floor else []
    _alone(_picture, scene, [Path(out) / f"{way}_0" for way in WAYS], Path(out) / "surface.png")
    report = {"figures": figures, "stages": stages}
    json_files.write(Path(out) / "surface.json", report)
    return report


def _alone(stage: Callable, *arguments: Any) -> tuple[Any, dict[str, float]]:
    """What a stage returns when run in a fresh process, and what it cost."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(_measured, stage, *arguments).result()


def _measured(stage: Callable, *arguments: Any) -> tuple[Any, dict[str, float]]:
    clocks = (time.perf_counter, time.process_time)
    started = [clock() for clock in clocks]
    result = stage(*arguments)
    seconds, cpu_seconds = (clock() - start for clock, start in zip(clocks, started, strict=True))
    return result, {"seconds": seconds, "cpu_seconds": cpu_seconds, "peak_gib": peak_memory() / 2**30}


def _train(name: str, scene: str, folder: Path, seed: int, vanilla: bool) -> None:
    from gsjax import pipeline

    normals = Path(scene) / "normals"
    given = [f"normals={normals}"] if normals.is_dir() else []
    settings = load_settings(name, [f"seed={seed}", f"vanilla={str(vanilla).lower()}", *given])
    pipeline.train(scene, folder, settings, resume=folder.exists())


def _mesh(folder: Path) -> None:
    from gsjax import pipeline

    pipeline.mesh(folder, folder / "mesh.ply")


def _refine(folder: Path, out: Path, seed: int, assignments: Sequence[str]) -> None:
    from gsjax import config, pipeline
    from gsjax.binding.refining import PRESETS, Refinement

    whole = config.to_dict(config.parse(Refinement, {**PRESETS["fast"], "seed": seed}))
    pipeline.refine(folder, out, config.parse(Refinement, config.override(whole, assignments)), resume=out.exists())


def _texture(folder: Path) -> None:
    from gsjax import pipeline

    pipeline.texture(folder, folder / "mesh.ply", folder / "textured.glb")


def _score(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Figures of a run and its mesh, and those of the true mesh where there is one."""
    from dataclasses import asdict

    from gsjax import pipeline
    from gsjax.meshing.export import read_mesh
    from gsjax.meshing.topology import topology

    figures = pipeline.evaluate(folder, mesh=folder / "mesh.ply")
    scores, floor = ({key: f[key] for key in FIGURES if key in f} for f in (figures, figures.get("floor", {})))
    return scores | asdict(topology(read_mesh(folder / "mesh.ply"))), floor


def _picture(scene: str, folders: Sequence[Path], out: Path) -> None:
    """One held-out view: the photo and, a column each, the meshes in grey above and in their colours below."""
    from gsjax.io.images import write_image
    from gsjax.io.scenes import load_scene
    from gsjax.meshing import headlight, read_mesh, render_mesh, vertex_colors

    frame = load_scene(scene).held_out_frames[0]
    factor = PICTURE_SIZE / max(frame.width, frame.height)
    K = frame.K * np.array([[factor], [factor], [1]])
    size = round(factor * frame.width), round(factor * frame.height)
    columns = [
        np.concatenate([render_mesh(read_mesh(f / "mesh.ply"), frame.viewmat, K, *size, shading=s) for s in shadings])
        for f in folders
        for shadings in [(headlight, vertex_colors)]
    ]
    write_image(out, np.concatenate(columns, axis=1))


def main() -> None:
    """Reads the arguments and prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config", choices=CONFIGS, metavar="CONFIG", help="of configs.py")
    parser.add_argument("--scene", required=True, help="folder of the data set")
    parser.add_argument("--out", required=True, metavar="DIR", help="empty folder for the runs")
    parser.add_argument("--seeds", type=parsers.count, default=3, metavar="N", help="runs of every way (default: 3)")
    parser.add_argument("--refine", nargs="+", default=[], metavar="KEY=VALUE", help="settings of the refinement")
    arguments = parser.parse_args()
    report = run(arguments.config, arguments.scene, arguments.out, seeds=arguments.seeds, refinement=arguments.refine)
    for part in ("figures", "stages"):
        print(tables.compare({label: tables.spread(rows) for label, rows in report[part].items() if rows}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
