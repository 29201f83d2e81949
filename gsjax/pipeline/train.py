"""A data set to Gaussians, in a run folder that can be stopped and continued at any moment."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jax
import numpy as np
from jax import Array
from jax.sharding import Mesh

import rasterizer
from gsjax import config, runs
from gsjax.effects.alignment import align
from gsjax.effects.simulation import NO_EFFECTS, Effects
from gsjax.errors import InputError
from gsjax.io.machine import peak_memory
from gsjax.io.ply import write_gaussians
from gsjax.metrics.photos import score_images
from gsjax.pipeline.training_journal import TrainingJournal
from gsjax.planning.preparation import RunRequest, StepInputs, plan_run, prepare, report
from gsjax.planning.start import first_state
from gsjax.planning.warm_start import copy_normals, shared_steps
from gsjax.rendering.engine import computes_on_cpu
from gsjax.report.page import report_if_installed
from gsjax.report.view_pictures import keep_skies, picture_keeper
from gsjax.runs.compilations import make_room
from gsjax.runs.journal import starting_point
from gsjax.runs.photo_effects import moves_line, with_moved_cameras, write_photo_effects
from gsjax.runs.processes import from_first, is_first, own_folder
from gsjax.runs.result import write_views
from gsjax.settings import Settings
from gsjax.stereo import write_stereo_maps
from gsjax.training import data_parallel, optimizers
from gsjax.training.data_parallel import Devices
from gsjax.training.densification.rules import DensificationRule
from gsjax.training.loop import Progress, Work, follow
from gsjax.training.optimizers import Optimizer
from gsjax.training.state import TrainState
from gsjax.training.terms import Term


def train(
    scene: str | Path,
    out: str | Path,
    settings: Settings | Mapping[str, Any],
    *,
    terms: Mapping[str, Term | Callable[..., Array]] = MappingProxyType({}),
    densification: DensificationRule | None = None,
    effects: Effects = NO_EFFECTS,
    resume: bool = False,
    warm_start: str | Path | None = None,
    observe: Callable[[Progress], None] | None = None,
    devices: Devices = 1,
) -> dict[str, Any]:
    """Train Gaussians on a data set.

    Several processes that were joined (`gsjax.runs.processes`) call it alike; the first alone writes. A run with
    own terms, a rule or effects needs them again to resume; the manifest names them.

    Args:
        scene: Folder of the data set, see `gsjax.io.scenes.load_scene`.
        out: Run folder, see `gsjax.runs`; absent or empty unless `resume`.
        settings: The run, or a table of it such as `gsjax.presets.PRESETS["quick"]`. A phase gives terms of the loss
            their weights by name.
        terms: The run's own loss terms by name, in addition to those of `gsjax.training.terms.TERMS` or in their place:
            functions of (Gaussians, View, Batch), or a `Term` that says what such a function needs.
        densification: The run's own rule of densification, in place of the one that `density.rule` names.
        effects: The run's own effects by name, simulated in addition to those that `effects.names` chooses.
        resume: Continue `out` from its last checkpoint; with the same settings it ends with the same numbers.
        warm_start: Another run folder, of the same settings until the phases part. Training starts at its last
            checkpoint before that, so what both have in common is trained once. None: at the first step.
        observe: Called after every step, before its checkpoint is written. On a GPU it is called once for several,
            and the state is that of the very step only where figures are logged, a checkpoint is written or a phase
            ends.
        devices: How many share the views of a step, or "all"; `settings.views_per_step` is a multiple of them.

    Returns:
        `psnr` and `ssim` (None without held-out views; with effects also the other ways of
        `gsjax.metrics.photos.score_images`), `views`, `gaussians`, `steps`, `train_seconds`.

    Raises:
        InputError: The data set, the normals, a weight, a term, the run folder or the devices cannot be used; or a loss
            or a gradient is not finite, before that step.
    """
    settings = config.as_record(Settings, settings)
    warm_start = None if warm_start is None else Path(warm_start)
    if warm_start is not None and runs.latest_checkpoint(warm_start) is None:
        raise InputError(f"{warm_start}: has no checkpoint to begin from")
    make_room()
    rasterizer.prepare()
    with own_folder(out) as folder:
        pieces = terms, densification, effects
        request = plan_run(scene, folder, settings, *pieces, resume=resume, warm_start=warm_start, devices=devices)
        prepared = prepare(request)
        steps_in_common = request.warm_start and shared_steps(request.warm_start, prepared.plan)
        run = _open_run(request, prepared)
        with runs.claim_run(run):
            runs.update_manifest(run, **prepared.notes)
            if prepared.stereo and is_first():
                write_stereo_maps(run, prepared.stereo)
            state, seconds = _fit(run, request, prepared, steps_in_common, observe)
            return _write(run, prepared, state, seconds)


def _open_run(request: RunRequest, prepared: StepInputs) -> Path:
    settings = config.to_dict(request.settings)
    if request.resumed:
        return runs.reopen(request.out, settings, scene=request.scene)
    return runs.create(
        request.out,
        settings,
        scene=request.scene,
        seed=request.settings.seed,
        similarity=prepared.scene.similarity,
        place=prepared.scene.place,
        plan=prepared.plan.record(),
        split=prepared.split,
    )


def _fit(
    run: Path,
    request: RunRequest,
    prepared: StepInputs,
    steps_in_common: int | None,  # with the run of a warm start
    observe: Callable[[Progress], None] | None,
) -> tuple[TrainState, float]:
    """Take the steps of the plan from the newest checkpoint on; return the state, on one device, and the seconds."""
    planned, effects, mesh = prepared.plan, prepared.effects, request.mesh
    optimizer = optimizers.make_optimizer(
        planned.rates, prepared.extent, planned.rates.decay_steps, views_per_step=planned.views_per_step
    )
    model = replace(request.settings.model, max_gaussians=planned.max_gaussians)
    initial = partial(first_state, prepared.start, model, planned.rule, optimizer, effects.effects, skies=effects.skies)
    state, capacity, seconds = starting_point(run, initial, request.warm_start, steps_in_common)
    if request.warm_start is not None:
        copy_normals(request.warm_start, run, planned, int(state.step))
    state = _of_first(state, initial)
    whole = (lambda state: state) if mesh is None else jax.device_get
    with TrainingJournal(run, planned, prepared.scene, int(state.step), seconds, effects, whole) as journal:
        work = _work(prepared, optimizer, mesh, journal, observe)
        if mesh is not None:  # Of several processes only the first knows the stored capacity.
            state, capacity = data_parallel.replicate(state, mesh), None
        state = whole(follow(work, state, capacity))
        return state, journal.seconds


def _work(
    prepared: StepInputs,
    optimizer: Optimizer,
    mesh: Mesh | None,
    journal: TrainingJournal,
    observe: Callable[[Progress], None] | None,
) -> Work:
    """What the phases share."""
    effects, frames = prepared.effects, prepared.scene.train_frames

    def note(progress: Progress) -> None:
        if observe is not None:
            observe(progress)
        journal.note(progress)

    def normals(state: TrainState) -> list[np.ndarray]:
        state = journal.whole(state)
        moved = with_moved_cameras(frames, effects.photo_effects(state.effects).moves)
        return [from_first(each) for each in prepared.normals(state.gaussians, moved)]

    return Work(
        prepared.plan,
        frames,
        prepared.extent,
        optimizer,
        normal_source=normals,
        observe=note,
        effects=effects.effects,
        mesh=mesh,
        depths=prepared.depths,
        skies=effects.skies,
        keep=prepared.keep,
        # A CPU computes all the while, and has no step's memory to spare.
        looks=None if mesh is not None or computes_on_cpu() else journal.looks,
        shares=partial(prepared.normals.shares_compared, frames),
    )


def _of_first(state: TrainState, initial: Callable[[int], TrainState]) -> TrainState:
    """The state that the first process starts from, which only it has read."""
    rows = int(from_first(np.int64(state.gaussians.num_gaussians)))
    if not is_first() and rows != state.gaussians.num_gaussians:
        state = initial(rows)
    return from_first(state)


def _write(run: Path, prepared: StepInputs, state: TrainState, seconds: float) -> dict[str, Any]:
    """Write Gaussians, cameras and effects, score the held-out views, and report."""
    effects = prepared.effects
    photo_effects = effects.photo_effects(state.effects)
    scene = replace(prepared.scene, frames=with_moved_cameras(prepared.scene.frames, photo_effects.moves))
    gaussians = jax.tree.map(np.asarray, state.gaussians.alive())
    world = scene.similarity.gaussians_to_world(gaussians)
    write_gaussians(run / "gaussians.ply", world, scene.place, cameras=scene.camera_centers)
    write_views(run, scene.frames, effects.skies)
    keep_skies(run, scene.frames, effects.skies)
    write_photo_effects(run, photo_effects)
    if photo_effects.moves:
        report(line := moves_line(photo_effects.moves, scene.similarity))
        runs.update_manifest(run, cameras=line)
    # The buffer as it is: a program for this very number of Gaussians would serve once.
    scores = score_images(
        state.gaussians,
        scene.held_out_frames,
        prepared.plan.background,
        photo_effects=photo_effects.with_near_appearances(scene.frames),
        align=align if photo_effects.moves else None,
        depth_mode=prepared.plan.depth_mode,
        observe=picture_keeper(run),
    )
    summary = {
        **scores,
        "gaussians": gaussians.num_gaussians,
        "steps": int(state.step),
        "train_seconds": round(seconds, 1),
    }
    runs.update_manifest(run, status="done", peak_gib=round(peak_memory() / 2**30, 2), **summary)
    report_if_installed(run)
    return summary
