"""Real photos with `--effects none` and with `auto`: scores in all four ways, degrees of the harmonics, seconds.

    python experiments/auto_or_none.py SCENE ... --out DIR [--width 150] [--steps 1000] [--effects none auto]

Photos are brought to about that width. Steps are those of a short run of the photometric loss: a fifth at half the
size, then at all of it, with density control to the last fifth, which goes on without. `DIR/auto_or_none.md` is the
table, `DIR/auto_or_none.json` its figures. Called again it does what is left.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from handled import timed

from gsjax import config, pipeline, tables
from gsjax.cli.parsers import count
from gsjax.io import json_files
from gsjax.io.machine import machine
from gsjax.io.scenes import load_scene
from gsjax.settings import FAST, Settings

SCORES = [f"{score}{way}" for score in ("psnr", "ssim") for way in ("", "_near_gains", "_track_gains", "_fitted")]
FIRST = 20  # steps that are not timed


def settings(effects: str, downscale: float, given: argparse.Namespace, seed: int, has_mattes: bool) -> Settings:
    """The preset `fast`, shorter and without normals."""
    parts = round(0.2 * given.steps), round(0.6 * given.steps), round(0.2 * given.steps)
    changes = {
        "seed": seed,
        "effects": effects,
        "downscale": downscale,
        "background": "random" if has_mattes else "black",
        "max_gaussians": given.gaussians,
        "sh_every": given.steps // 10,
        "phases": [
            {"name": "coarse", "steps": parts[0], "image_scale": 2, "density_control": True},
            {"name": "vanilla", "steps": parts[1], "density_control": True},
            {"name": "settling", "steps": parts[2]},
        ],
        "density": {"stop": given.steps // 2},
        "logging": {"evaluate_every": 0, "checkpoint_every": given.steps},
    }
    return config.parse(Settings, config.merge(FAST, changes))


def row(scene: Path, effects: str, given: argparse.Namespace, seed: int) -> dict[str, Any]:
    """Trains unless that was done, and scores."""
    run = given.out / f"{scene.name}_{effects.replace(',', '_')}_{seed}"
    if not (run / "scored.json").exists():
        frames = load_scene(scene).frames
        downscale = max(1.0, round(max(frame.width for frame in frames) / given.width, 2))
        chosen = settings(effects, downscale, given, seed, frames[0].pixels().matte is not None)
        started = time.process_time()
        times = timed(scene, run, chosen)
        figures = pipeline.evaluate(run, three_ways=load_scene(scene).tracks is not None)
        manifest = json_files.read(run / "manifest.json")
        kept = {name: figures.get(name) for name in (*SCORES, "gaussians")}
        kept |= {
            "simulated": manifest.get("effects", {}).get("simulated", []),
            "harmonics": manifest.get("harmonics"),
            "seconds before": times[0] - started,
            "ms a step": 1e3 * float(np.median(np.diff(times)[FIRST:])),
        }
        json_files.write(run / "scored.json", kept)
    return {"scene": scene.name, "effects": effects, "seed": seed, **json_files.read(run / "scored.json")}


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown, a row a run."""
    heads = ["scene", "effects", "taken in", "degree", *SCORES, "ms a step"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for each in rows:
        taken = ", ".join(each["simulated"]) or "nothing"
        degree = str(each["harmonics"]["degree"]) if each["harmonics"] else "3"
        cells = [each["scene"], each["effects"], taken, degree]
        cells += [tables.shown(each[name]) for name in (*SCORES, "ms a step")]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--effects", nargs="+", default=["none", "auto"])
    parser.add_argument("--width", type=int, default=150)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--gaussians", type=int, default=8000)
    parser.add_argument("--seeds", type=count, default=1)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for scene in given.scenes:
        for effects in given.effects:
            rows += [row(scene, effects, given, seed) for seed in range(given.seeds)]
            json_files.write(given.out / "auto_or_none.json", {"rows": rows, "machine": machine()})
            (given.out / "auto_or_none.md").write_text(table(rows))
    print(table(rows))


if __name__ == "__main__":
    main()
