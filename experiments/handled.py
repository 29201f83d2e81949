"""An effect put into the built-in scene, ignored and simulated: scores, cameras against the truth, and seconds.

    python experiments/handled.py poses --out DIR [--strengths 0 0.1 0.3] [--views 24] [--size 96] [--steps 500]

A strength of 0 is the clean scene: what simulating the effect costs where it is absent. Poses: degrees about each axis,
and as many radians of the median distance along each. `DIR/handled.md` is the table, `DIR/handled.json` its figures.
Called again it does what is left.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from relit import relight
from scipy.spatial.transform import Rotation

from gsjax import config, pipeline, tables
from gsjax.effects.diagnosis import diagnose
from gsjax.effects.twists import gauge
from gsjax.io import analytic_scene, runs
from gsjax.io.machine import machine
from gsjax.io.scenes import load_scene
from gsjax.settings import Settings

PUT_IN: dict[str, Callable[[float], dict[str, float]]] = {
    "poses": lambda degrees: {"turn": degrees, "shift": float(np.radians(degrees))},
}


def settings(effects: str, steps: int, seed: int) -> Settings:
    """A short run of the photometric loss."""
    return config.parse(
        Settings,
        {
            "seed": seed,
            "effects": effects,
            "background": "white",
            "max_gaussians": 3000,
            "sh_degree": 1,
            "sh_every": max(steps // 3, 1),
            "phases": [{"name": "vanilla", "steps": steps, "density_control": True}],
            "density": {"rule": "error", "start": steps // 5, "stop": 4 * steps // 5, "reset_every": 0},
            "logging": {"evaluate_every": 0, "checkpoint_every": max(steps, 1)},
        },
    )


def row(scene: Path, run: Path, effects: str, steps: int, seed: int) -> dict[str, Any]:
    """Trains unless that was done, and scores."""
    if not (run / "evaluation.json").exists():
        pipeline.train(scene, run, settings(effects, steps, seed), resume=(run / "config.json").exists())
        figures = pipeline.evaluate(run, aligned=True)
        runs.write_json(run / "evaluation.json", figures | camera_errors(scene, run))
    figures = runs.read_json(run / "evaluation.json")
    names = ("psnr", "psnr_aligned", "chamfer", "turn_deg", "shift", "train_seconds")
    return {name: figures.get(name) for name in names}


def camera_errors(scene: Path, run: Path) -> dict[str, float]:
    """Root mean square errors of the training cameras, degrees and shares of the median distance.

    Without what moves all cameras with the world (`gsjax.effects.twists`), which is nobody's error.
    """
    loaded = load_scene(scene)
    told = runs.read_json(scene / "relit.json") if (scene / "relit.json").exists() else {}
    true = {f.name: np.asarray(told.get("viewmats", {}).get(f.name, f.viewmat), float) for f in loaded.frames}
    depths = np.concatenate([loaded.points @ f.viewmat[2, :3] + f.viewmat[2, 3] for f in loaded.frames])
    unit = float(np.median(depths[depths > 0]))
    records = [record for record in runs.read_json(run / "cameras.json") if not record["held_out"]]
    pairs = [(np.asarray(record["viewmat"], float), true[record["name"]]) for record in records]
    twists = np.array(
        [
            [
                *Rotation.from_matrix(right[:3, :3].T @ found[:3, :3]).as_rotvec(),
                *(center(right) - center(found)) / unit,
            ]
            for found, right in pairs
        ]
    ).ravel()
    fixed = gauge(np.stack([center(right) for _, right in pairs]), unit)
    left = (twists - fixed @ (fixed.T @ twists)).reshape(-1, 2, 3)
    turn, shift = np.sqrt(np.square(left).sum(-1).mean(0))
    return {"turn_deg": float(np.degrees(turn)), "shift": float(shift)}


def center(viewmat: np.ndarray) -> np.ndarray:
    """`[3]` camera centre."""
    return -viewmat[:3, :3].T @ viewmat[:3, 3]


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("effect", choices=PUT_IN)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--strengths", type=float, nargs="+", default=[0.0, 0.1, 0.3])
    parser.add_argument("--views", type=int, default=24)
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--seeds", type=int, default=1)
    given = parser.parse_args()
    clean = given.out / "clean"
    if not clean.exists():
        analytic_scene.write(clean, num_views=given.views, size=(given.size, given.size))
    rows: list[dict[str, Any]] = []
    for strength in given.strengths:
        scene = given.out / f"{given.effect}_{strength:g}" if strength else clean
        if not scene.exists():
            relight(clean, scene, **PUT_IN[given.effect](strength))
        evidence = diagnose(load_scene(scene)).effects[given.effect]
        for effects in ("none", given.effect):
            for seed in range(given.seeds):
                run = given.out / f"run_{given.effect}_{strength:g}_{effects}_{seed}"
                said = {"strength": strength, "on": evidence.on, "evidence": evidence.value, "effects": effects}
                rows.append(said | {"seed": seed} | row(scene, run, effects, given.steps, seed))
                runs.write_json(given.out / "handled.json", {"rows": rows, "machine": machine()})
    heads = list(rows[0])
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    lines += ["| " + " | ".join(tables.shown(each[name]) for name in heads) + " |" for each in rows]
    (given.out / "handled.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
