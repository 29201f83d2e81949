"""An effect put into the built-in scene, ignored and simulated: scores, cameras against the truth, and seconds.

    python experiments/handled.py poses --out DIR --strengths 0 0.1 0.3 [--views 24] [--size 96] [--steps 500]
    python experiments/handled.py background --out DIR --strengths 0 1

Poses: degrees about each axis, and as many radians of the median distance along each; 0 is the clean scene. Background:
how far the white one goes to a sky's colours, and training is not told that it is white. `DIR/handled.md` is the table,
`DIR/handled.json` its figures. Called again it does what is left.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from relit import relight

from gsjax import config, gallery, pipeline, tables
from gsjax.effects.diagnosis import diagnose
from gsjax.io import analytic_scene, runs
from gsjax.io.machine import machine
from gsjax.io.scenes import load_scene
from gsjax.pipeline.result import frame_camera, open_result, scene_of_run
from gsjax.settings import Settings

POINTS, SMALL = 300, 1e-4  # that stand for all; of a world's change, to first order
PUT_IN: dict[str, Callable[[float], dict[str, float]]] = {
    "poses": lambda degrees: {"turn": degrees, "shift": float(np.radians(degrees))},
    "background": lambda share: {"sky": share},
}


def settings(effects: str, steps: int, seed: int, background: str) -> Settings:
    """A short run of the photometric loss."""
    return config.parse(
        Settings,
        {
            "seed": seed,
            "effects": effects,
            "background": background,
            "max_gaussians": 3000,
            "sh_degree": 1,
            "sh_every": max(steps // 3, 1),
            "phases": [{"name": "vanilla", "steps": steps, "density_control": True}],
            "density": {"rule": "error", "start": steps // 5, "stop": 4 * steps // 5, "reset_every": 0},
            "logging": {"evaluate_every": 0, "checkpoint_every": max(steps, 1)},
        },
    )


def row(scene: Path, run: Path, chosen: Settings) -> dict[str, Any]:
    """Trains unless that was done, and scores."""
    if not (run / "evaluation.json").exists():
        pipeline.train(scene, run, chosen, resume=(run / "config.json").exists())
        figures = pipeline.evaluate(run, aligned=True)
        runs.write_json(run / "evaluation.json", figures | camera_errors(scene, run) | haze(run))
    figures = runs.read_json(run / "evaluation.json")
    names = ("psnr", "psnr_aligned", "cameras_px", "sky_alpha", "chamfer", "train_seconds")
    return {name: figures.get(name) for name in names}


def haze(run: Path) -> dict[str, float]:
    """Mean coverage by Gaussians of the held-out pixels that show no surface."""
    result, scene = open_result(run), scene_of_run(run)
    assert scene.truth is not None, "the built-in scene is known"
    cameras = [frame_camera(frame) for frame in scene.held_out_frames]
    pictures = gallery.pictures(result.gaussians, cameras, result.background)
    labels = [scene.truth.labels[frame.name]() for frame in scene.held_out_frames]
    covered = [picture.alphas[label == 0] for picture, label in zip(pictures, labels, strict=True)]
    return {"sky_alpha": float(np.concatenate(covered).mean())}


def camera_errors(scene: Path, run: Path) -> dict[str, float]:
    """How far the points of the scene are from their true pixels in the training photos, pixels: root mean square.

    Without what the best small turn, shift and growth of the world explains, which is nobody's error.
    """
    loaded = load_scene(scene)
    told = runs.read_json(scene / "relit.json") if (scene / "relit.json").exists() else {}
    true = {frame.name: (frame.viewmat, frame.K) for frame in loaded.frames}
    true |= {name: (np.asarray(viewmat), true[name][1]) for name, viewmat in told.get("viewmats", {}).items()}
    found = [record for record in runs.read_json(run / "cameras.json") if not record["held_out"]]
    rng = np.random.default_rng(0)
    points = loaded.points[rng.permutation(len(loaded.points))[:POINTS]].astype(np.float64)
    offsets = points - points.mean(0)
    worlds = [np.cross(axis, offsets) for axis in np.eye(3)] + [np.ones_like(points) * axis for axis in np.eye(3)]
    right = np.concatenate([pixels(points, *true[record["name"]]) for record in found])
    errors = np.concatenate([pixels(points, record["viewmat"], record["K"]) for record in found]) - right
    modes = [
        (np.concatenate([pixels(points + SMALL * w, *true[r["name"]]) for r in found]) - right) / SMALL
        for w in [*worlds, offsets]
    ]
    slopes = np.stack([mode.ravel() for mode in modes], -1)
    left = errors.ravel() - slopes @ np.linalg.lstsq(slopes, errors.ravel(), rcond=None)[0]
    return {"cameras_px": float(np.sqrt(np.square(left).reshape(-1, 2).sum(-1).mean()))}


def pixels(points: np.ndarray, viewmat: Any, K: Any) -> np.ndarray:
    """`[P, 2]` places of points in a picture."""
    viewmat, K = np.asarray(viewmat, np.float64), np.asarray(K, np.float64)
    shown = (points @ viewmat[:3, :3].T + viewmat[:3, 3]) @ K.T
    return shown[:, :2] / shown[:, 2:]


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
                chosen = settings(effects, given.steps, seed, "black" if given.effect == "background" else "white")
                rows.append(said | {"seed": seed} | row(scene, run, chosen))
                runs.write_json(given.out / "handled.json", {"rows": rows, "machine": machine()})
    heads = list(rows[0])
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    lines += ["| " + " | ".join(tables.shown(each[name]) for name in heads) + " |" for each in rows]
    (given.out / "handled.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
