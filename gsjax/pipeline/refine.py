"""A mesh and Gaussians bound to it, trained together on a run's photos, in a run folder of their own."""

import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from gsjax import config, refining
from gsjax.bound import BoundGaussians, bind, to_gaussians, to_mesh
from gsjax.errors import InputError
from gsjax.io import checkpoints, runs
from gsjax.io.ply import write_gaussians
from gsjax.io.scenes import load_scene
from gsjax.mesh_terms import mesh_graph
from gsjax.meshing.cleaning import clean
from gsjax.meshing.export import read_mesh, write_mesh
from gsjax.pipeline.evaluate import score_images
from gsjax.pipeline.result import write_cameras
from gsjax.refining import Refinement, RefineProgress, RefineState
from gsjax.scene import Scene, extent
from gsjax.training import BACKGROUNDS, largest_need
from gsjax.views import stack_views

LOGGED_EVERY, SAVED_EVERY = 50, 500  # steps


def refine(
    run: str | Path, out: str | Path, settings: Refinement, *, mesh: str | Path | None = None, resume: bool = False
) -> dict[str, Any]:
    """Refine a mesh on the photos of the run that it came from.

    Args:
        run: Run folder; its data set, background and masks are used, its Gaussians are not.
        out: Folder for the result, absent or empty unless `resume`: `mesh.ply` and `mesh.glb` with vertex colours,
            `gaussians.ply` in the 3DGS layout, `report.json`, and what makes it a run folder that can be scored and
            rendered.
        settings: The refinement.
        mesh: Any mesh in the data set's coordinates. None: `RUN/mesh.ply`.
        resume: Continue `out` from its last checkpoint; with the same settings and mesh.

    Returns:
        The report: `psnr`, `ssim` and `views` of the held-out views, `vertices`, `faces`, `gaussians`, `steps`,
        `train_seconds`.

    Raises:
        InputError: The run, its data set or the mesh cannot be read, no triangle is seen, or the folder is in use or
            cannot be written.
    """
    run = Path(run)
    source = run / "mesh.ply" if mesh is None else Path(mesh)
    if mesh is None and not source.exists():
        raise InputError(f"{source}: no such mesh; `gsjax mesh {run} --out {source}` makes it, or name one with --mesh")
    manifest, trained = runs.read_json(run / "manifest.json"), runs.read_json(run / "config.json")
    scene = load_scene(manifest["scene"], downscale=trained["downscale"], folder_masks=trained["masks"])
    coarse, _ = clean(read_mesh(source), max_faces=settings.faces)
    data, size = stack_views(scene.train_frames), extent(scene.train_frames)
    bound = bind(
        coarse,
        per_triangle=settings.per_triangle,
        thickness=settings.thickness * size,
        sh_degree=settings.sh_degree,
        opacity=settings.opacity,
    )
    if not int(largest_need(bound, data)):
        raise InputError(f"{source}: no training view of {scene.root} sees any of its {coarse.num_faces} triangles")

    asked = {**trained, "mesh": str(source.resolve()), "refinement": config.to_dict(settings)}
    folder = runs.reopen(out, asked) if resume else runs.create(out, asked, scene=scene.root, seed=settings.seed)
    optimizer = refining.make_optimizer(settings, size, coarse.num_vertices)
    state, capacity, seconds = _latest(folder, refining.initial_state(bound, optimizer))
    runs.truncate_metrics(folder, int(state.step))
    with _Journal(folder, settings.steps, int(state.step), seconds) as journal:
        state = refining.refine(
            settings,
            mesh_graph(np.asarray(state.gaussians.faces)),
            data,
            state,
            optimizer,
            background=BACKGROUNDS[trained["background"]],
            observe=journal.note,
            capacity=capacity,
        )
        return _finish(folder, scene, trained["background"], state.gaussians, settings.steps, journal.seconds)


def _latest(folder: Path, initial: RefineState) -> tuple[RefineState, int | None, float]:
    """State, pair capacity and seconds of the newest checkpoint, or of the start."""
    found = runs.latest_checkpoint(folder)
    if found is None:
        return initial, None, 0.0
    stored = checkpoints.load(found[1], _checkpoint(initial, 0, 0.0))
    return jax.tree.map(jnp.asarray, stored["state"]), int(stored["capacity"]), float(stored["seconds"])


def _checkpoint(state: RefineState, capacity: int, seconds: float) -> dict[str, Any]:
    return {"state": state, "capacity": np.int64(capacity), "seconds": np.float64(seconds)}


def _finish(
    folder: Path, scene: Scene, background: str, bound: BoundGaussians, steps: int, seconds: float
) -> dict[str, Any]:
    refined, gaussians = to_mesh(bound), to_gaussians(bound)
    write_mesh(folder / "mesh.ply", refined)
    write_mesh(folder / "mesh.glb", refined)
    write_gaussians(folder / "gaussians.ply", gaussians)
    write_cameras(folder / "cameras.json", scene.frames)
    summary = {
        **score_images(gaussians, scene.held_out_frames, background),
        "vertices": refined.num_vertices,
        "faces": refined.num_faces,
        "gaussians": gaussians.num_gaussians,
        "steps": steps,
        "train_seconds": round(seconds, 1),
    }
    runs.write_json(folder / "report.json", summary)
    runs.update_manifest(folder, status="done", **summary)
    return summary


class _Journal:
    """What a refinement leaves behind while it goes: a progress bar, metrics and checkpoints."""

    def __init__(self, folder: Path, steps: int, step: int, seconds: float):
        self.folder, self.steps, self.recent = folder, steps, []
        self._seconds_before, self._started = seconds, time.perf_counter()
        self._bar = tqdm(total=steps, initial=step, desc="refine", unit="step", smoothing=0.05)

    def __enter__(self) -> "_Journal":
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    @property
    def seconds(self) -> float:
        """Time so far, earlier sessions of this refinement included."""
        return self._seconds_before + time.perf_counter() - self._started

    def note(self, progress: RefineProgress) -> None:
        self._bar.update()
        self.recent.append(progress.metrics.psnr)
        last = progress.step == self.steps
        if progress.step % LOGGED_EVERY == 0 or last:
            self._log(progress)
        if progress.step % SAVED_EVERY == 0 or last:
            tree = _checkpoint(progress.state, progress.capacity, self.seconds)
            runs.save_checkpoint(self.folder, progress.step, tree)

    def _log(self, progress: RefineProgress) -> None:
        metrics = progress.metrics
        record = {
            "step": progress.step,
            "loss": float(metrics.loss),
            # Single views differ by decibels.
            "psnr": sum(map(float, self.recent)) / len(self.recent),
            "pairs": int(metrics.needed),
            "seconds": round(self.seconds, 2),
            "terms": {name: float(value) for name, value in metrics.terms.items()},
        }
        self.recent = []
        runs.append_metrics(self.folder, record)
        self._bar.set_postfix_str(f"loss {record['loss']:.4f}, PSNR {record['psnr']:.1f} dB", refresh=False)
