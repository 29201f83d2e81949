"""What does accuracy cost in time? The presets on some scenes and seeds, and plain 3DGS with the steps of each.

    python experiments/accuracy_vs_time.py --out DIR --scene NAME=PATH[@DOWNSCALE] ... [--seeds N] [--presets ...]

Trains, meshes and scores one run after another, seed by seed. A run of the scene `room` is also compared with the depth
sensor (`room.py`), one of a scene with a true surface with that. Every run becomes a row of
`results/accuracy_vs_time.json`, with its processor. A row that is there is not run again; rows of another version of
the product are dropped. Times are those of seed 0, which one machine should run. Redraws
`docs/assets/accuracy_vs_time.png` and prints the table of `docs/accuracy_vs_time.md`.
"""

import argparse
import itertools
import json
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import records
from records import PICTURES, ROOT, Row

from gsjax.cli import run_guarded
from gsjax.io import json_files
from gsjax.io.files import atomic_path
from gsjax.io.machine import machine

NAME = "accuracy_vs_time"
PRESETS = "quick", "fast", "balanced"
SURFACE = {"f5": "F at 5 cm", "chamfer": "Chamfer distance, 1e-3"}
HEADS = (
    *("Scene", "Preset", "Normals", "Steps; Gaussians", "Minutes", "Processor seconds"),
    *("PSNR", "SSIM", "Mesh normals", "Surface"),
)


def run(out: Path, scenes: Mapping[str, str], seeds: int, presets: Sequence[str]) -> list[Row]:
    """Run what is left; return the rows of all runs."""
    rows = records.read(NAME)
    for seed, name, preset, vanilla in itertools.product(range(seeds), scenes, presets, (False, True)):
        key = {"scene": name, "preset": preset, "vanilla": vanilla, "seed": seed}
        is_known = any(key.items() <= row.items() for row in rows)
        if not is_known and (preset, vanilla) != ("quick", True):  # `quick` has the image terms alone.
            folder = out / f"{name}_{preset}{'_vanilla' if vanilla else ''}_{seed}"
            print(f"== {folder.name}", flush=True)
            rows.append(key | measured(folder, scenes[name], preset, vanilla, seed))
            records.write(NAME, rows, page_table(rows))
    return rows


def measured(folder: Path, scene: str, preset: str, vanilla: bool, seed: int) -> Row:
    """Train, mesh and score one run; what a stopped call left of it is removed.

    Its times are of the whole training command: of the clock, and of the processor without compilations, which depends
    less on other programs.
    """
    shutil.rmtree(folder, ignore_errors=True)
    path, _, downscale = scene.partition("@")
    settings = ["--downscale", downscale or "1", "--set", f"seed={seed}", f"schedule.vanilla={str(vanilla).lower()}"]
    begin, before = time.perf_counter(), _processor_seconds()
    _gsjax("train", path, "--out", str(folder), "--preset", preset, *settings)
    minutes, seconds = (time.perf_counter() - begin) / 60, _processor_seconds() - before
    _gsjax("mesh", str(folder), "--out", str(folder / "mesh.ply"), "--method", "tsdf")
    _gsjax("eval", str(folder), "--mesh", str(folder / "mesh.ply"), "--json", str(folder / "eval.json"))
    steps = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    compiled = sum(each["seconds"] for step in steps for each in step.get("compiled", ()))
    scores = json_files.read(folder / "eval.json")
    row = {
        "cpu": machine()["cpu"],
        "minutes": minutes,
        "processor_seconds": seconds - compiled,
        "compilation_seconds": compiled,
        "steps": scores["steps"],
        "gaussians": scores["gaussians"],
        "psnr": scores.get("psnr_near_gains", scores["psnr"]),
        "ssim": scores.get("ssim_near_gains", scores["ssim"]),
    }
    return row | _surface(folder, scores)


def _processor_seconds() -> float:
    return sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])  # of users and of the system


def _surface(folder: Path, scores: Mapping[str, Any]) -> Row:
    import room

    from gsjax.meshing.export import read_mesh
    from gsjax.metrics.geometry import sample_surface

    if "chamfer" in scores:
        return {"chamfer": 1e3 * scores["chamfer"], "mesh_normals": scores["mesh_normal_error_deg"]}
    if not folder.name.startswith("room"):
        return {}
    truth, mesh = room.read_truth(ROOT.parent / "shared/data/room"), read_mesh(folder / "mesh.ply")
    start = room.camera_alignment(folder, truth)
    alignment = room.icp(mesh, start, sample_surface(truth.mesh, room.TRUTH_POINTS, 2)[0])
    figures = room.scores(room.moved(mesh, alignment), truth)
    return {"f5": figures["F5"], "mesh_normals": figures["normal_error_deg"]}


def _gsjax(*arguments: str) -> None:
    subprocess.run([sys.executable, "-m", "gsjax", *arguments], check=True, stdout=subprocess.DEVNULL)


def page_table(rows: Sequence[Row]) -> str:
    """The table of the page: means over seeds, and half of the range; times of seed 0."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["scene"], row["preset"], row["vanilla"]), []).append(row)
    lines = [list(HEADS)]
    for (scene, preset, vanilla), group in groups.items():
        first = group[0]  # seed 0
        normals = "none" if vanilla or preset == "quick" else "stereo of the photos"
        kind = next((each for each in SURFACE if each in first), None)
        lines.append(
            [
                f"*{scene}*",
                f"vanilla 3DGS, steps of `{preset}`" if vanilla else f"`{preset}`",
                normals,
                f"{first['steps']:,}; {first['gaussians']:,}",
                f"{first['minutes']:.1f}",
                f"{first['processor_seconds']:.0f}",
                spread(group, "psnr", 2, " dB"),
                spread(group, "ssim", 3),
                spread(group, "mesh_normals", 1, " deg") if "mesh_normals" in first else "",
                f"{SURFACE[kind].split(',')[0]} {spread(group, kind, 3 if kind == 'f5' else 2)}" if kind else "",
            ]
        )
    head, *body = (f"| {' | '.join(line)} |\n" for line in lines)
    return head + f"|{'---|' * len(lines[0])}\n" + "".join(body)


def spread(rows: Sequence[Row], name: str, digits: int, unit: str = "") -> str:
    """Mean over seeds and half of the range, in words."""
    values = np.array([row[name] for row in rows], float)
    half = f" +-{np.ptp(values) / 2:.{digits}f}" if len(values) > 1 else ""
    return f"{values.mean():.{digits}f}{half}{unit}"


def draw(rows: Sequence[Row], file: Path) -> None:
    """A panel a scene and score, against seconds; a line a method, a dot a seed."""
    from gsjax.report.figures import new_figure

    scores = {"psnr": "PSNR, dB"} | SURFACE
    charts = [
        (scene, name)
        for name in scores
        for scene in dict.fromkeys(row["scene"] for row in rows)
        if any(name in row for row in rows if row["scene"] == scene)
    ]
    across = min(len(charts), 3)
    down = -(-len(charts) // across)
    figure = new_figure(3.2 * across, 2.7 * down)
    panels = figure.subplots(down, across, squeeze=False).flat
    for panel, (scene, name) in zip(panels, charts, strict=False):
        for label, vanilla, style in (("presets", False, "o-"), ("vanilla 3DGS", True, "s:")):
            points = _points([row for row in rows if (row["scene"], row["vanilla"]) == (scene, vanilla)], name)
            if points:
                (dots,) = panel.plot(*np.concatenate(points).T, style[0], label=label)
                panel.plot(*np.transpose([each.mean(axis=0) for each in points]), style[1:], color=dots.get_color())
        panel.set(title=f"{scene}: {scores[name]}", xlabel="processor seconds", xscale="log")
        panel.xaxis.get_major_locator().set_params(subs=(1, 2, 5))
        panel.xaxis.set(major_formatter="{x:.0f}", minor_formatter="")
    for panel in [*panels][len(charts) :]:
        panel.set_axis_off()
    figure.axes[0].legend(fontsize=8)
    with atomic_path(file) as temporary:
        figure.savefig(temporary, dpi=130, format="png")


def _points(rows: Sequence[Row], name: str) -> list[np.ndarray]:
    """Of every preset, `[S, 2]` seconds of seed 0 and the score."""
    points: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        group = points.setdefault(row["preset"], [])
        group.append((group[0][0] if group else row["processor_seconds"], row[name]))
    return [np.array(each) for each in points.values()]


def main() -> None:
    """Read the arguments, measure, draw, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the runs")
    parser.add_argument("--scene", nargs="+", required=True, metavar="NAME=PATH[@DOWNSCALE]", help="data sets")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="of every run (default: 3)")
    parser.add_argument("--presets", nargs="+", default=PRESETS, metavar="NAME", help=f"default: {' '.join(PRESETS)}")
    arguments = parser.parse_args()
    scenes = dict(each.split("=", 1) for each in arguments.scene)
    rows = run(arguments.out, scenes, arguments.seeds, arguments.presets)
    draw(rows, PICTURES / f"{NAME}.png")
    print(page_table(rows))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
