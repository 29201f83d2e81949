"""Effects put into the built-in scene, each at several strengths and not at all: found, ignored, simulated, forced on.

    python experiments/handled.py --out DIR [--effects NAME ...] [--views 32] [--size 112] [--steps 600] [--seeds N]

Every effect and strength is one row: what `train --effects auto` decides, how far off the parameters that it learns
are, and PSNR and Chamfer distance of a run that ignores it and of one that simulates it. In the row of strength 0 the
latter is forced on. PSNR is that of the held-out photos as they were before anything was put in, from where they were
truly taken: both runs are asked for the same pictures. `DIR/handled.md` is the table, `DIR/handled.json` its figures.
Called again it does what is left.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from relit import relight, sky_color

from gsjax import config, pipeline, runs, tables
from gsjax.cli.parsers import count
from gsjax.effects import transients, vignetting
from gsjax.effects.alignment import align
from gsjax.io import analytic_scene, json_files
from gsjax.io.machine import machine
from gsjax.io.scenes import load_scene
from gsjax.meshing.export import read_mesh
from gsjax.pipeline.evaluate import score_mesh
from gsjax.pipeline.train import trial_start
from gsjax.planning.effects import joined
from gsjax.planning.sizes import training_extent
from gsjax.planning.trials import gains
from gsjax.render import backdrop, gallery
from gsjax.runs.checkpoints import load_arrays
from gsjax.runs.photography import Photography, read_photography, refined
from gsjax.runs.result import frame_camera, open_result
from gsjax.scene import Scene
from gsjax.scoring.images import score_images
from gsjax.settings import Settings

POINTS, SMALL = 300, 1e-4  # that stand for all; of a world's change, to first order
STOPS = 2.2 / np.log(2)  # of light, in a natural logarithm of display-coded values
FIRST = 20  # steps that are not timed: they compile
NAMES = "ignored", "simulated"


class Truth(NamedTuple):
    """What an effect's error is told from."""

    clean: Scene  # as it was
    scene: Scene  # as training gets it
    told: dict[str, Any]  # what was put in, see `relit.relight`
    run: Path


@dataclass(frozen=True)
class Case:
    """An effect that is put in."""

    strengths: tuple[float, ...]  # beside none
    put_in: Callable[[float], dict[str, float]]  # strength -> options of `relit.relight`
    error: Callable[[Truth], float]  # of what a run learned
    unit: str  # of that


def of_gains(truth: Truth) -> float:
    """Root mean square over the photos that are trained on and their channels, EV."""
    names = [frame.name for frame in truth.scene.train_frames]
    true = np.array([truth.told["gains"][name] if truth.told else np.zeros(3) for name in names])
    looks = read_photography(truth.run).looks
    found = STOPS * np.array([looks[name].log_gains if looks else np.zeros(3) for name in names])
    return float(np.sqrt(np.square(found - true + true.mean(0)).mean()))


def of_corner(truth: Truth) -> float:
    """Light of a corner against the middle's, EV."""
    frame, looks = truth.scene.train_frames[0], read_photography(truth.run).looks
    found = 0.0
    if looks:
        camera = frame_camera(frame)
        falloff = np.asarray(vignetting.falloff(jnp.asarray(looks[frame.name].falloff, jnp.float32), camera))
        found = STOPS * float(falloff[0, 0])
    return abs(found - truth.told.get("corner", 0.0))


def of_cameras(truth: Truth) -> float:
    """How far points are from their true pixels in the training photos, pixels: root mean square.

    Without what the best small turn, shift and growth of the world explains, which is nobody's error.
    """
    true = {frame.name: (frame.viewmat, frame.K) for frame in truth.clean.train_frames}
    found = [record for record in json_files.read(truth.run / "cameras.json") if not record["held_out"]]
    rng = np.random.default_rng(0)
    points = truth.clean.points[rng.permutation(len(truth.clean.points))[:POINTS]].astype(np.float64)
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
    return float(np.sqrt(np.square(left).reshape(-1, 2).sum(-1).mean()))


def of_sky(truth: Truth) -> float:
    """Mean difference of what is behind all from the sky, over the sky of the held-out photos, of 255."""
    result, share = open_result(truth.run), truth.told.get("sky", 0.0)
    found = []
    for frame in truth.clean.held_out_frames:
        behind = np.asarray(backdrop.behind(jnp.asarray(result.background, jnp.float32), frame_camera(frame)))
        is_sky = truth.clean.truth.labels[frame.name]() == 0  # pyright: ignore[reportOptionalMemberAccess]
        off = np.abs(np.broadcast_to(behind, (*is_sky.shape, 3)) - sky_color(frame, share))
        found.append(off[is_sky])
    return 255 * float(np.concatenate(found).mean())


def of_masks(truth: Truth) -> float:
    """Share of what was pasted in that is trusted, and of the rest that is not: the larger."""
    arrays = load_arrays(runs.latest_checkpoint(truth.run)[1])  # pyright: ignore[reportOptionalSubscript]
    threshold = arrays.get("['state'].effects.numbers['transients']")
    if threshold is None:
        return 1.0
    result, wrong = open_result(truth.run), {True: [], False: []}
    frames = truth.scene.train_frames
    drawn = gallery.pictures(result.gaussians, [frame_camera(f) for f in frames], result.background)
    for before, after, picture in zip(truth.clean.train_frames, frames, drawn, strict=True):
        photo = after.pixels().image
        pasted = (photo != before.pixels().image).any(-1)
        trusted = transients.trusted(jnp.asarray(threshold), picture.colors, jnp.asarray(photo, jnp.float32) / 255)
        for there, off in ((True, trusted), (False, ~trusted)):
            wrong[there].append(np.asarray(off)[pasted == there])
    return float(max(np.concatenate(each).mean() for each in wrong.values() if np.concatenate(each).size))


def pixels(points: np.ndarray, viewmat: Any, K: Any) -> np.ndarray:
    """`[P, 2]` places of points in a picture."""
    viewmat, K = np.asarray(viewmat, np.float64), np.asarray(K, np.float64)
    shown = (points @ viewmat[:3, :3].T + viewmat[:3, 3]) @ K.T
    return shown[:, :2] / shown[:, 2:]


CASES = {
    "exposure": Case((0.1, 0.3), lambda stops: {"exposure": stops, "balance": stops / 3}, of_gains, "EV"),
    "vignetting": Case((0.2, 0.5), lambda stops: {"corner": -stops}, of_corner, "EV"),
    "poses": Case(
        (0.1, 0.3, 0.5), lambda degrees: {"turn": degrees, "shift": float(np.radians(degrees))}, of_cameras, "px"
    ),
    "background": Case((0.5, 1.0), lambda share: {"sky": share}, of_sky, "/255"),
    "transients": Case((0.3, 0.6), lambda share: {"pasted": share}, of_masks, "of pixels"),
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


def timed(scene: Path, run: Path, chosen: Settings) -> list[float]:
    """Trains, or goes on; the processor's time after every step, seconds."""
    times: list[float] = []
    pipeline.train(
        scene,
        run,
        chosen,
        resume=(run / "config.json").exists(),
        observe=lambda progress: times.append(time.process_time()),
    )
    return times


def trained(scene: Path, run: Path, chosen: Settings) -> float:
    """Trains unless that was done; median processor seconds of a step."""
    if not (run / "timed.json").exists():
        times = timed(scene, run, chosen)
        json_files.write(run / "timed.json", {"seconds_per_step": float(np.median(np.diff(times)[FIRST:]))})
    return json_files.read(run / "timed.json")["seconds_per_step"]


def scored(truth: Truth, background: str, *, aligned: bool) -> dict[str, Any]:
    """PSNR of the true held-out photos, from where they were taken and from where they fit best; Chamfer distance."""
    file = truth.run / f"scored{'_aligned' if aligned else ''}.json"
    if not file.exists():
        result, found = open_result(truth.run), read_photography(truth.run)
        photos = truth.scene if truth.told.get("sky") else truth.clean
        true = {frame.name: frame.viewmat for frame in truth.clean.frames}
        frames = [replace(frame, viewmat=true[frame.name]) for frame in photos.held_out_frames]
        scores = score_images(
            result.gaussians,
            refined(tuple(frames), found.moves),
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
    case, scene = CASES[effect], clean
    if strength:
        scene = out / f"{effect}_{strength:g}"
        if not scene.exists():
            relight(clean, scene, **case.put_in(strength))
    told = json_files.read(scene / "relit.json") if strength else {}
    # A sky is not known to whoever starts a run; the clean scene's white is.
    background = "black" if effect == "background" and strength else "white"
    chosen = [settings(e, given.steps, given.gaussians, seed, background) for e in ("auto", "none", effect)]
    before, after = load_scene(clean), load_scene(scene)
    size = training_extent(after)
    trial = partial(gains, chosen[0], after.train_frames, size, partial(trial_start, after, chosen[0]))
    joined_by_auto = joined(chosen[0], after, trial).evidence
    assert joined_by_auto is not None, "auto looks"
    evidence = joined_by_auto["evidence"][effect]
    said = {(True, True): "hit", (True, False): "miss", (False, True): "false alarm", (False, False): "right"}
    figures = {
        "effect": effect,
        "strength": strength,
        "evidence": evidence["evidence"],
        "decision": said[strength > 0, effect in joined_by_auto["simulated"]],
        "seed": seed,
    }
    for name, effects in zip(NAMES, chosen[1:], strict=True):
        run = out / f"run_{scene.name}_{effects.effects}_{background}_{seed}"
        seconds, truth = trained(scene, run, effects), Truth(before, after, told, run)
        scores = scored(truth, background, aligned=effect == "poses") | {"error": case.error(truth)}
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
        evidence = tables.shown(float(np.mean([row["evidence"] for row in seeds])))
        lines.append("| " + " | ".join([f"`{effect}`", f"{strength:g}", evidence, said, *pairs]) + " |")
    return "\n".join(lines) + "\n"


def _pooled(values: list[float | None], key: str) -> str:
    found = [value for value in values if value is not None]
    if not found:
        return "-"
    mean = tables.shown(float(np.mean(found)))
    return f"{mean} ({min(found):.2f}-{max(found):.2f})" if key == "psnr" and len(found) > 1 else mean


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--effects", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--views", type=int, default=32)
    parser.add_argument("--size", type=int, default=112)
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--gaussians", type=int, default=4000)
    parser.add_argument("--seeds", type=count, default=1)
    given = parser.parse_args()
    clean = given.out / "clean"
    if not clean.exists():
        analytic_scene.write(clean, num_views=given.views, size=(given.size, given.size))
    rows: list[dict[str, Any]] = []
    for effect in given.effects:
        for strength in (0.0, *CASES[effect].strengths):
            rows += [row(given.out, clean, effect, strength, given, seed) for seed in range(given.seeds)]
            json_files.write(given.out / "handled.json", {"rows": rows, "machine": machine()})
            (given.out / "handled.md").write_text(table(rows))
    print(table(rows))


if __name__ == "__main__":
    main()
