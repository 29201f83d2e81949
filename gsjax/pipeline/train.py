"""A data set to Gaussians, in a run folder that can be stopped and continued at any moment."""

import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from gsjax import config, density_control, fitting, initialize, optimizers, training
from gsjax.errors import InputError
from gsjax.fitting import Progress
from gsjax.gaussians import Gaussians, take
from gsjax.io import checkpoints, runs
from gsjax.io.ply import write_gaussians
from gsjax.io.scenes import load_scene
from gsjax.pipeline.evaluate import score_images
from gsjax.pipeline.prior import RunPrior
from gsjax.pipeline.result import write_cameras
from gsjax.scene import Scene, extent
from gsjax.settings import Settings, total_steps
from gsjax.training import TrainState


def train(scene: str | Path, out: str | Path, settings: Settings, *, resume: bool = False) -> dict[str, Any]:
    """Train Gaussians on a data set.

    Args:
        scene: Folder of the data set, see `gsjax.io.scenes.load_scene`.
        out: Run folder, see `gsjax.io.runs`; absent or empty unless `resume`.
        settings: The run.
        resume: Continue `out` from its last checkpoint; with the same settings it ends with the same numbers.

    Returns:
        `psnr`, `ssim` and `views` of the held-out views, `gaussians`, `steps`, `train_seconds`.

    Raises:
        InputError: The data set, the normals or the run folder cannot be used.
    """
    loaded = load_scene(scene, downscale=settings.downscale, folder_masks=settings.masks)
    frames = loaded.train_frames
    if not loaded.held_out_frames or not frames:
        raise InputError(f"{scene}: {len(loaded.frames)} usable photos leave none to train on or none to score")
    size = extent(frames)
    if size <= 0:
        raise InputError(f"{scene}: all {len(frames)} training cameras are at one place, nothing can be reconstructed")
    prior = RunPrior(Path(out), settings.normals, frames)
    as_dict = config.to_dict(settings)
    run = runs.reopen(out, as_dict) if resume else runs.create(out, as_dict, scene=scene, seed=settings.seed)

    optimizer = optimizers.make_optimizer(settings.rates, size, settings.rates.decay_steps or total_steps(settings))
    first = initialize.from_points(
        loaded.points, loaded.point_colors, capacity=settings.max_gaussians, sh_degree=settings.sh_degree
    )
    state, capacity, seconds = _latest(run, training.initial_state(first, optimizer))
    runs.truncate_metrics(run, int(state.step))
    with Journal(run, settings, loaded, int(state.step), seconds) as journal:
        state = fitting.fit(
            settings, frames, size, state, optimizer, prior=prior, observe=journal.note, capacity=capacity
        )
        return _finish(run, settings, loaded, state, journal.seconds)


def living(gaussians: Gaussians) -> Gaussians:
    """The Gaussians without the free rows of their buffers, numpy."""
    return jax.tree.map(np.asarray, take(gaussians, np.asarray(density_control.is_alive(gaussians))))


def _latest(run: Path, initial: TrainState) -> tuple[TrainState, int | None, float]:
    """State, pair capacity and seconds of the newest checkpoint, or of the start."""
    found = runs.latest_checkpoint(run)
    if found is None:
        return initial, None, 0.0
    like = {"state": initial, "capacity": np.int64(0), "seconds": np.float64(0)}
    stored = checkpoints.load(found[1], like)
    state = jax.tree.map(jnp.asarray, stored["state"])
    return state, int(stored["capacity"]) or None, float(stored["seconds"])


def _finish(run: Path, settings: Settings, scene: Scene, state: TrainState, seconds: float) -> dict[str, Any]:
    gaussians = living(state.gaussians)
    write_gaussians(run / "gaussians.ply", gaussians)
    write_cameras(run / "cameras.json", scene.frames)
    scores = score_images(gaussians, scene.held_out_frames, settings.background)
    summary = {
        **scores,
        "gaussians": gaussians.num_gaussians,
        "steps": int(state.step),
        "train_seconds": round(seconds, 1),
    }
    runs.update_manifest(run, status="done", **summary)
    return summary


class Journal:
    """What a run leaves behind while it goes: a progress bar, metrics and checkpoints."""

    def __init__(self, run: Path, settings: Settings, scene: Scene, step: int, seconds: float):
        self.run, self.settings, self.scene = run, settings, scene
        self._seconds_before, self._started = seconds, time.perf_counter()
        self._bar = tqdm(total=total_steps(settings), initial=step, desc="train", unit="step", smoothing=0.05)

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    @property
    def seconds(self) -> float:
        """Training time so far, scoring and earlier sessions of this run included."""
        return self._seconds_before + time.perf_counter() - self._started

    def note(self, progress: Progress) -> None:
        """Log, score and save as the settings say."""
        every, last = self.settings.logging, progress.step == total_steps(self.settings)
        self._bar.set_description(progress.phase.name, refresh=False)
        self._bar.update()
        scored = every.evaluate_every > 0 and progress.step % every.evaluate_every == 0 and not last
        if scored or last or progress.step % every.metrics_every == 0:
            self._log(progress, scored)
        if progress.step % every.checkpoint_every == 0 or last:
            # The last step of a phase leaves the buffer's capacity to the next phase.
            tree = {
                "state": progress.state,
                "capacity": np.int64(0 if progress.phase_done else progress.capacity),
                "seconds": np.float64(self.seconds),
            }
            runs.save_checkpoint(self.run, progress.step, tree)

    def _log(self, progress: Progress, scored: bool) -> None:
        metrics = progress.metrics
        record = {
            "step": progress.step,
            "phase": progress.phase.name,
            "loss": float(metrics.loss),
            "psnr": float(metrics.psnr),
            "gaussians": int(training.count_alive(progress.state.gaussians)),
            "pairs": int(metrics.needed),
            "seconds": round(self.seconds, 2),
            "terms": {name: float(value) for name, value in metrics.terms.items()},
        }
        if scored:
            gaussians = living(progress.state.gaussians)
            scores = score_images(gaussians, self.scene.held_out_frames, self.settings.background)
            record["held_out_psnr"] = scores["psnr"]
        runs.append_metrics(self.run, record)
        self._bar.set_postfix_str(
            f"loss {record['loss']:.4f}, PSNR {record['psnr']:.1f} dB, {record['gaussians']:,} Gaussians", refresh=False
        )
