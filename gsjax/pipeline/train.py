"""A data set to Gaussians, in a run folder that can be stopped and continued at any moment."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from gsjax import config
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians, take
from gsjax.io import runs
from gsjax.io.ply import write_gaussians
from gsjax.io.scenes import load_scene
from gsjax.pipeline.evaluate import score_images
from gsjax.pipeline.journal import Journal, beginning
from gsjax.pipeline.prior import RunPrior
from gsjax.pipeline.result import write_views
from gsjax.scene import Scene, extent, in_memory
from gsjax.settings import Settings, total_steps
from gsjax.training import density_control, initialize, optimizers
from gsjax.training.loop import Progress, fit
from gsjax.training.step import TrainState, count_alive, initial_state


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
    # Read once, here, so that a damaged photo is found before the run begins.
    loaded = replace(loaded, frames=tuple(map(in_memory, loaded.frames)))
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
    state, capacity, seconds = beginning(run, initial_state(first, optimizer))
    with TrainingJournal(run, settings, loaded, int(state.step), seconds) as journal:
        state = fit(settings, frames, size, state, optimizer, prior=prior, observe=journal.note, capacity=capacity)
        return _finish(run, settings, loaded, state, journal.seconds)


def living(gaussians: Gaussians) -> Gaussians:
    """The Gaussians without the free rows of their buffers, numpy."""
    return jax.tree.map(np.asarray, take(gaussians, np.asarray(density_control.is_alive(gaussians))))


def _finish(run: Path, settings: Settings, scene: Scene, state: TrainState, seconds: float) -> dict[str, Any]:
    gaussians = living(state.gaussians)
    write_gaussians(run / "gaussians.ply", gaussians)
    write_views(run, scene.frames)
    scores = score_images(gaussians, scene.held_out_frames, settings.background)
    summary = {
        **scores,
        "gaussians": gaussians.num_gaussians,
        "steps": int(state.step),
        "train_seconds": round(seconds, 1),
    }
    runs.update_manifest(run, status="done", **summary)
    return summary


class TrainingJournal(Journal):
    """Logs, scores and saves as the settings say."""

    def __init__(self, run: Path, settings: Settings, scene: Scene, step: int, seconds: float):
        """Begin at `step`."""
        super().__init__(run, "train", total_steps(settings), step, seconds)
        self.settings, self.scene = settings, scene

    def note(self, progress: Progress) -> None:
        """What the loop tells after every step."""
        every, last = self.settings.logging, progress.step == self.steps
        self.bar.set_description(progress.phase.name, refresh=False)
        self.bar.update()
        scored = every.evaluate_every > 0 and progress.step % every.evaluate_every == 0 and not last
        if scored or last or progress.step % every.metrics_every == 0:
            count = int(count_alive(progress.state.gaussians))
            more: dict[str, Any] = {"phase": progress.phase.name, "gaussians": count}
            if scored:
                more["held_out_psnr"] = self._held_out_psnr(progress.state)
            self.log(progress.step, progress.metrics, f", {count:,} Gaussians", **more)
        if progress.step % every.checkpoint_every == 0 or last:
            # The last step of a phase leaves the buffer's capacity to the next phase.
            self.save(progress.step, progress.state, 0 if progress.phase_done else progress.capacity)

    def _held_out_psnr(self, state: TrainState) -> float:
        frames, background = self.scene.held_out_frames, self.settings.background
        return score_images(living(state.gaussians), frames, background)["psnr"]
