"""A data set to Gaussians, in a run folder that can be stopped and continued at any moment."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jax
import numpy as np
from jax import Array
from jax.sharding import Mesh
from tqdm import tqdm

import rasterizer
from gsjax import config, runs
from gsjax.effects.alignment import align
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians, is_alive, take
from gsjax.io import normal_folders
from gsjax.io.machine import peak_memory
from gsjax.io.ply import write_gaussians
from gsjax.metrics.photos import score_images
from gsjax.pipeline.training_journal import TrainingJournal
from gsjax.planning import sparse_view_trial
from gsjax.planning.effect_validation import EffectValidation
from gsjax.planning.effects import ChosenEffects, choose_effects, look_for_effects
from gsjax.planning.measured_depth import measured_depth
from gsjax.planning.memory import fit_to_memory
from gsjax.planning.sizes import at_size, training_extent
from gsjax.planning.sky_masks import read_sky_masks
from gsjax.planning.sparse_views import ENTRY, for_sparse_views
from gsjax.planning.start import first_state, with_given_points, with_stereo_points
from gsjax.planning.warm_start import shared_steps, take_normals
from gsjax.rendering.engine import computes_on_cpu, engine_here
from gsjax.report.page import report_if_installed
from gsjax.report.view_pictures import keep_skies, picture_keeper
from gsjax.runs.compilations import make_room
from gsjax.runs.journal import starting_point
from gsjax.runs.normal_source import NormalSource, note_normals
from gsjax.runs.photo_effects import moves_line, with_moved_cameras, write_photo_effects
from gsjax.runs.processes import from_first, is_first, own_folder, same_everywhere
from gsjax.runs.result import write_views
from gsjax.runs.run import Run
from gsjax.runs.splits import require_photos_of_effects, split_of
from gsjax.scene import Scene, preload
from gsjax.settings import AUTO, Settings
from gsjax.training import data_parallel, optimizers
from gsjax.training.data_parallel import Devices, device_mesh
from gsjax.training.densification.rules import DENSIFICATION_RULES
from gsjax.training.loop import Progress, Work, follow
from gsjax.training.plan import Plan, check_terms, plan
from gsjax.training.state import TrainState
from gsjax.training.terms import Term


def train(
    scene: str | Path,
    out: str | Path,
    settings: Settings | Mapping[str, Any],
    *,
    terms: Mapping[str, Term | Callable[..., Array]] = MappingProxyType({}),
    resume: bool = False,
    warm_start: str | Path | None = None,
    observe: Callable[[Progress], None] | None = None,
    devices: Devices = 1,
) -> dict[str, Any]:
    """Train Gaussians on a data set.

    Several processes that were joined (`gsjax.runs.processes`) call it alike; the first alone writes.

    Args:
        scene: Folder of the data set, see `gsjax.io.scenes.load_scene`.
        out: Run folder, see `gsjax.runs.folder`; absent or empty unless `resume`.
        settings: The run, or a table of it such as `gsjax.presets.PRESETS["quick"]`. A phase gives terms of the loss
            their weights by name.
        terms: The run's own terms of the loss by name, beside those of `gsjax.training.terms.TERMS` or in their place:
            functions of (Gaussians, View, Batch), or a `Term` that says what such a function needs.
        resume: Continue `out` from its last checkpoint; with the same settings it ends with the same numbers.
        warm_start: Another run folder, of the same settings until the phases part. Training starts at its last
            checkpoint before that, so what both have in common is trained once. None: at the first step.
        observe: Told of every step, before its checkpoint is written. On a GPU it is told of several at once, and the
            state is that of the very step only where figures are logged, a checkpoint is written or a phase ends.
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
        if not resume:
            runs.require_free(folder)
        known = Run.open(folder).plan if resume and is_first() and runs.can_resume(folder) else None
        if known:
            runs.require_scene(folder, scene)
        mesh = device_mesh(devices, settings.schedule.views_per_step)
        planned = _planned(scene, settings, terms, known)
        return _train(scene, folder, settings, planned, known, warm_start, observe, mesh)


def _planned(
    scene: str | Path,
    settings: Settings,
    terms: Mapping[str, Term | Callable[..., Array]],
    known: Mapping[str, Any] | None,
) -> Plan:
    """The plan before anybody looked at the photos."""
    planned = plan(settings, terms)
    if known and "max_gaussians" in known:  # Memory may have borne fewer than were asked for.
        planned = replace(planned, max_gaussians=known["max_gaussians"])
    if settings.supervision.normals is None:
        return planned
    return replace(
        planned, normals=known["normals"] if known else normal_folders.find(scene, settings.supervision.normals)
    )


def _beginning_lines(planned: Plan, settings: Settings, photos_line: str) -> list[str]:
    """Where the run computes and with which engine, on what, and what of the plan may surprise."""
    engine = engine_here()
    lines = [f"on {engine.device} with the {engine.name} rasterizer", photos_line]
    if settings.schedule.dropout:
        lines.append(f"every step leaves out {settings.schedule.dropout:.0%} of the Gaussians")
    if any(phase.rule is DENSIFICATION_RULES["adc"] for phase in planned.phases):
        lines.append(f"densification stops at max_gaussians={planned.max_gaussians:,}; 3DGS has no such bound")
    if settings.supervision.normals is None and "normals" in planned.needs:
        lines.append("no maps of normals (--normals): the run's own depth stands in for a network")
    return lines


def _train(
    scene: str | Path,
    out: Path,
    settings: Settings,
    planned: Plan,
    known: Mapping[str, Any] | None,
    warm_start: Path | None,
    observe: Callable[[Progress], None] | None,
    mesh: Mesh | None,
) -> dict[str, Any]:
    begun_in = out if known else warm_start  # whose checkpoint is in coordinates of its own
    begun = None if begun_in is None else Run(begun_in)
    loaded, downscale, photos_line = at_size(
        scene,
        settings,
        planned.steps,
        known and known["downscale"],
        run=begun,
    )
    split = (begun and begun.split) or split_of(loaded.frames)
    if begun and runs.latest_checkpoint(begun.folder):
        require_photos_of_effects(loaded, split, begun.manifest, run=begun.folder)
    check_terms(planned, loaded.train_frames)
    trial = (lambda *how: same_everywhere(sparse_view_trial.gain(*how))) if begun is None else None
    before = None if begun is None else begun.manifest.get(ENTRY)
    planned, sparse = for_sparse_views(planned, loaded, settings, trial=trial, before=before, may_lower=known is None)
    fitted = fit_to_memory(planned, loaded.frames, out, may_lower=mesh is None and known is None)
    planned = fitted.plan
    for line in fitted.lines:
        print(f"train: {line}", file=sys.stderr)
    # Read once, and before the run begins: a damaged photo is found now.
    photos = tqdm(loaded.frames, desc="photos", unit="photo", leave=False)
    loaded = replace(loaded, frames=tuple(preload(frame, fitted.keep) for frame in photos))
    _require_pixels(loaded)
    # Only now: what the engine needs was compiled meanwhile.
    sparse_line = () if sparse is None else (sparse.line(planned),)
    for line in (*_beginning_lines(planned, settings, photos_line), *sparse_line):
        print(f"train: {line}", file=sys.stderr)
    looked = look_for_effects(settings.effects.names, loaded)
    loaded, frames = looked.scene, looked.scene.train_frames
    size = training_extent(loaded)
    notify = partial(note_normals, out)
    maps, mode = settings.supervision, settings.model.depth_mode
    how = maps.normal_axes, frames, mode, maps.normal_gate
    normal_source = NormalSource(out, planned.normals, *how, keep=fitted.keep, notify=notify)
    measured, started = measured_depth(loaded, settings), with_given_points(loaded, settings)
    if measured is not None:
        print(f"train: depth {measured.line}", file=sys.stderr)
    sized = settings.replace(model={"max_gaussians": planned.max_gaussians})
    if begun_in is None or runs.latest_checkpoint(begun_in) is None:
        started, stereo_lines = with_stereo_points(started, planned)
        for line in stereo_lines:
            print(f"train: {line}", file=sys.stderr)
    validate = EffectValidation(
        sized,
        planned,
        frames,
        size,
        lambda short, optimizer, effects, skies: first_state(started, short, optimizer, effects, skies=skies),
    )
    skies = read_sky_masks(loaded, settings, downscale)
    before = None if begun is None else begun.manifest.get("effects")
    chosen = choose_effects(
        settings.effects.names,
        planned,
        loaded,
        lambda *how: same_everywhere(validate(*how)),
        looked,
        skies=skies,
        with_sky=settings.effects.sky == AUTO,
        before=before,
    )
    planned = replace(planned.with_effects(chosen.names), downscale=downscale)
    optimizer = optimizers.make_optimizer(
        planned.rates, size, planned.rates.decay_steps, views_per_step=planned.views_per_step
    )
    in_common = None if warm_start is None else shared_steps(warm_start, planned)
    as_dict = config.to_dict(settings)
    run = (
        runs.reopen(out, as_dict, scene=scene)
        if known
        else runs.create(
            out,
            as_dict,
            scene=scene,
            seed=settings.seed,
            similarity=loaded.similarity,
            place=loaded.place,
            plan=planned.record(),
            split=split,
        )
    )
    with runs.claim_run(run):
        memory = {"memory": "; ".join(fitted.lines)} if fitted.lines else {}
        runs.update_manifest(run, photos=photos_line, **memory, **({} if sparse is None else {ENTRY: asdict(sparse)}))
        if chosen.evidence:
            runs.update_manifest(run, effects=chosen.evidence)
        initial = partial(first_state, started, sized, optimizer, chosen.effects, skies=chosen.skies)
        state, capacity, seconds = starting_point(run, initial, warm_start, in_common)
        if warm_start is not None:
            take_normals(warm_start, run, planned, int(state.step))
        state = _of_first(state, initial)
        state, whole = (state, _unchanged) if mesh is None else (data_parallel.replicate(state, mesh), jax.device_get)
        with TrainingJournal(run, planned, loaded, int(state.step), seconds, chosen, whole) as journal:

            def told(progress: Progress) -> None:
                if observe is not None:
                    observe(progress)
                journal.note(progress)

            def normals(state: TrainState) -> list[np.ndarray]:
                state = whole(state)
                maps = normal_source(
                    state.gaussians, with_moved_cameras(frames, chosen.photo_effects(state.effects).moves)
                )
                return [from_first(each) for each in maps]

            # A CPU computes all the while, and has no step's memory to spare.
            waits = mesh is not None or computes_on_cpu()
            looks = None if waits else journal.looks
            depths = None if measured is None else measured.depths
            work = Work(
                planned,
                frames,
                size,
                optimizer,
                normals,
                told,
                chosen.effects,
                mesh,
                depths,
                chosen.skies,
                fitted.keep,
                looks,
                partial(normal_source.shares_compared, frames),
            )
            # Of several processes only the first knows the stored one.
            capacity = capacity if mesh is None else None
            state = whole(follow(work, state, capacity))
            return _finish(run, planned, loaded, state, chosen, journal.seconds)


def _unchanged(state: TrainState) -> TrainState:
    return state


def _require_pixels(scene: Scene) -> None:
    """Refuses masks that leave nothing to train on."""
    masks = [frame.pixels().valid for frame in scene.train_frames]
    if not any(mask is None or mask.any() for mask in masks):
        raise InputError(f"{scene.root}: its masks leave no pixel of any photo; what is not 0 in a mask is used")


def _of_first(state: TrainState, initial: Callable[[int], TrainState]) -> TrainState:
    """The state that the first process goes on from, which only it has read."""
    rows = int(from_first(np.int64(state.gaussians.num_gaussians)))
    if not is_first() and rows != state.gaussians.num_gaussians:
        state = initial(rows)
    return from_first(state)


def living_gaussians(gaussians: Gaussians) -> Gaussians:
    """The Gaussians without the free rows of their buffers, numpy."""
    return jax.tree.map(np.asarray, take(gaussians, np.asarray(is_alive(gaussians))))


def _finish(
    run: Path, planned: Plan, scene: Scene, state: TrainState, chosen: ChosenEffects, seconds: float
) -> dict[str, Any]:
    found = chosen.photo_effects(state.effects)
    scene = replace(scene, frames=with_moved_cameras(scene.frames, found.moves))
    gaussians = living_gaussians(state.gaussians)
    world = scene.similarity.gaussians_to_world(gaussians)
    write_gaussians(run / "gaussians.ply", world, scene.place, cameras=scene.camera_centers)
    write_views(run, scene.frames, chosen.skies)
    keep_skies(run, scene.frames, chosen.skies)
    write_photo_effects(run, found)
    if found.moves:
        print(f"train: {(line := moves_line(found.moves, scene.similarity))}", file=sys.stderr)
        runs.update_manifest(run, cameras=line)
    # The buffer as it is: a program for this very number of Gaussians would serve once.
    scores = score_images(
        state.gaussians,
        scene.held_out_frames,
        planned.background,
        found=found.with_near_appearances(scene.frames),
        align=align if found.moves else None,
        depth_mode=planned.depth_mode,
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
