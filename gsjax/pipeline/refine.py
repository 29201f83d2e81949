"""A mesh, Gaussians bound to it and free ones beyond it, trained together on a run's photos, in a new run folder."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from tqdm import tqdm

from gsjax import config, runs
from gsjax.binding import refinement
from gsjax.binding.bound import BoundGaussians, bind, to_mesh
from gsjax.binding.mixed_gaussians import MixedGaussians, all_gaussians, with_free
from gsjax.binding.refinement import Refinement, RefineState
from gsjax.binding.refinement_terms import check_terms, refinement_terms
from gsjax.binding.uncovered import uncovered_gaussians
from gsjax.effects.alignment import align
from gsjax.effects.appearance import without_appearance
from gsjax.errors import InputError
from gsjax.gaussians import take
from gsjax.io import json_files
from gsjax.io.machine import free_memory, peak_memory
from gsjax.io.ply import write_gaussians
from gsjax.meshing.bisection import bisect_triangles
from gsjax.meshing.cleaning import clean
from gsjax.meshing.connectivity import border
from gsjax.meshing.export import read_mesh, write_mesh
from gsjax.meshing.photo_refine import MOST_VIEWS, refine_on_photos
from gsjax.meshing.pictures import depth_of_mesh, faces_of_pixels
from gsjax.meshing.ray_queries import ray_caster
from gsjax.metrics.photos import score_images
from gsjax.planning.memory import keep_photos, plain_bytes
from gsjax.planning.warm_start import pieces_record, require_pieces
from gsjax.report.page import report_if_installed
from gsjax.report.view_pictures import picture_keeper
from gsjax.runs.compilations import make_room
from gsjax.runs.journal import Journal, starting_point
from gsjax.runs.photo_effects import write_photo_effects
from gsjax.runs.relocation import relocate_scene
from gsjax.runs.result import DEPTH_OF_DISCS, QUIET, Result, open_result, scene_of_run, write_views
from gsjax.runs.run import Run
from gsjax.runs.splits import split_of
from gsjax.scene import Frame, Scene, extent, preload
from gsjax.scene.batches import Batches, decode, read_batches
from gsjax.scene.meshes import Mesh
from gsjax.training.capacity import largest_need
from gsjax.training.plan import phase_record, plan_record
from gsjax.training.step import BACKGROUNDS, Metrics
from gsjax.training.terms import LossTerm, Term, needs

LOGGED_EVERY, SAVED_EVERY = 50, 500  # steps


def refine(
    run: str | Path,
    out: str | Path,
    settings: Refinement | Mapping[str, Any],
    *,
    mesh: str | Path | None = None,
    terms: Mapping[str, Term | Callable[..., Array]] = MappingProxyType({}),
    resume: bool = False,
    scene_folder: str | Path | None = None,
) -> dict[str, Any]:
    """Refine a mesh on the photos of the run that it came from.

    Args:
        run: Run folder; its data set, background and masks are used, and with `settings.keep_free` those of its
            Gaussians that show what the mesh does not.
        out: Folder for the result, absent or empty unless `resume`: `mesh.ply` and `mesh.glb` with vertex colours,
            `gaussians.ply` in the 3DGS layout, `report.json`, `report.html`, and what makes it a run folder that can be
            scored and rendered.
        settings: The refinement, or a table of it such as `gsjax.binding.refinement.PRESETS["fast"]`.
        mesh: Any mesh in the data set's coordinates; all its parts are kept. None: `RUN/mesh.ply`.
        terms: The user's own loss terms by name, as `gsjax.pipeline.train` takes them, of `MixedGaussians`; they are
            needed again to resume.
        resume: Continue `out` from its last checkpoint; with the same settings and mesh.
        scene_folder: Where the data set is, if it was moved since the training; `out` records it. None: where it was.

    Returns:
        The report: `psnr`, `ssim` and `views` of the held-out views, `vertices`, `faces`, `gaussians` (those `bound` to
        the mesh and those `free`), `steps`, `train_seconds`, `taken_out` of the mesh before it was refined, and
        `photo_refine`, the report of `gsjax.meshing.photo_refine.refine_on_photos` (None without one, and after
        a resume beyond it).

    Raises:
        InputError: The run, its data set or the mesh cannot be read, a weight or a term cannot be used, no triangle is
            seen, or the folder is in use or cannot be written.
    """
    settings = config.as_record(Refinement, settings)
    make_room()
    run = Path(run)
    trained = Run.open(run)
    resume, pieces = resume and runs.can_resume(out), pieces_record(terms, None, {})
    if resume:
        require_pieces(Run.open(out), pieces)
    else:
        runs.require_free(out)
    weighed = refinement_terms(settings.weights, terms)
    source = run / "mesh.ply" if mesh is None else Path(mesh)
    if mesh is None and not source.exists():
        raise InputError(f"{source}: no such mesh; `gsjax mesh {run} --out {source}` makes it, or name another mesh")
    if resume and scene_folder is not None:
        relocate_scene(out, scene_folder)
    task = _prepare(settings, weighed, trained, source, Path(out), scene_of_run(run, scene=scene_folder))
    folder = _run_folder(task, out, resume=resume)
    with runs.claim_run(folder):
        runs.update_manifest(folder, **pieces)
        return _write(task, folder, *_fit(task, folder))


class _Task(NamedTuple):
    """What is refined, and on what; in local coordinates."""

    settings: Refinement
    terms: tuple[LossTerm, ...]
    trained: Run
    source: Path  # of the mesh
    scene: Scene
    frames: tuple[Frame, ...]  # the training photos without what their cameras did to the light
    data: Batches  # of these
    mesh: Mesh
    taken_out: dict[str, int]  # of the mesh, as of `prepare_mesh`
    bound: BoundGaussians  # to the mesh
    result: Result | None  # whose Gaussians may stay free


def _prepare(
    settings: Refinement, terms: tuple[LossTerm, ...], trained: Run, source: Path, out: Path, scene: Scene
) -> _Task:
    """Read photos and mesh, and bind Gaussians to it."""
    check_terms(terms, scene.train_frames)
    result = open_result(trained.folder) if settings.keep_free else None
    mesh, taken_out = prepare_mesh(
        scene.similarity.mesh_to_local(read_mesh(source)), settings.faces, settings.halved_share
    )
    photos, rows = scene.train_frames, settings.per_triangle * mesh.num_faces
    keep, lines = keep_photos(plain_bytes(photos), photos, rows, out, free_memory())
    for line in lines:
        print(f"refine: {line}", file=sys.stderr)
    # Held-out photos are read when they are scored, one by one.
    scene = replace(scene, frames=tuple(frame if frame.held_out else preload(frame, keep) for frame in scene.frames))
    # The Gaussians and the mesh are those of the mean photo: what each camera did is taken off its photo.
    frames, appearances = scene.train_frames, trained.photo_effects.appearances
    if appearances:
        frames = tuple(preload(without_appearance(frame, appearances[frame.name]), keep) for frame in frames)
    data = read_batches(frames, keep=keep)
    if taken_out["decimated"] and settings.halved_share:
        mesh = halved_where_seen(mesh, data, settings.faces)
    bound = bind(
        mesh,
        per_triangle=settings.per_triangle,
        thickness=settings.thickness * extent(frames),
        sh_degree=settings.sh_degree,
        opacity=settings.opacity,
        pixel_filter=settings.pixel_filter,
    )
    if not largest_need(bound, data):
        raise InputError(f"{source}: no training view of {scene.root} sees any of its {mesh.num_faces} triangles")
    return _Task(settings, terms, trained, source, scene, frames, data, mesh, taken_out, bound, result)


def _run_folder(task: _Task, out: str | Path, *, resume: bool) -> Path:
    settings, scene = task.settings, task.scene
    record = {**task.trained.settings, "mesh": str(task.source.resolve()), "refinement": config.to_dict(settings)}
    if resume:
        return runs.reopen(out, record, scene=scene.root)
    terms = {each.name: each.weight for each in task.terms}
    phase = phase_record("refine", settings.steps, terms, needs(task.terms), begin=0, end=settings.steps)
    plan = plan_record([phase], task.trained.downscale, None)
    about = {"similarity": scene.similarity, "place": scene.place, "split": split_of(scene.frames), "plan": plan}
    return runs.create(out, record, scene=scene.root, seed=settings.seed, **about)


def _fit(task: _Task, folder: Path) -> tuple[MixedGaussians, dict[str, Any]]:
    """Train from the last checkpoint on, and return the Gaussians and what the report says of the training."""
    settings, behind = task.settings, task.trained.photo_effects.background
    background = task.trained.settings["model"]["background"]
    optimizer = refinement.make_optimizer(settings, extent(task.frames), task.mesh.num_vertices)
    photo_report: dict[str, float] = {}

    def initial(rows: int | None) -> RefineState:
        if task.result is None:
            return refinement.initial_state(MixedGaussians(task.bound), optimizer)
        # A checkpoint fills whatever rows it finds: their number is all that matters.
        free = _free_rows(task) if rows is None else slice(rows - task.bound.num_gaussians)
        return refinement.initial_state(with_free(task.bound, take(task.result.gaussians, free)), optimizer)

    def move_mesh(bound: BoundGaussians) -> BoundGaussians:
        mesh, report = refine_on_photos(to_mesh(bound), task.frames)
        photo_report.update(report)
        return replace(bound, vertices=jnp.asarray(mesh.vertices))

    state, capacity, seconds = starting_point(folder, initial)
    with _RefinementJournal(folder, settings.steps, int(state.step), seconds) as journal:
        state = refinement.refine(
            settings,
            task.terms,
            task.data,
            state,
            optimizer,
            background=BACKGROUNDS[background] if behind is None else lambda key: jnp.asarray(behind),
            observe=journal.note,
            move_mesh=move_mesh,
            capacity=capacity,
        )
    summary = {"steps": settings.steps, "train_seconds": round(journal.seconds, 1), "taken_out": task.taken_out}
    return state.gaussians, summary | {"photo_refine": photo_report or None}


def prepare_mesh(original: Mesh, most_faces: int, halved_share: float = 0.0) -> tuple[Mesh, dict[str, int]]:
    """A mesh that Gaussians can be bound to: without triangles that spoil it, decimated where it has too many.

    Parts stay, however small: what to leave out was decided when the mesh was made. Decimation leaves `halved_share` of
    the triangles for later. One line says what went.

    Returns:
        The mesh, and numbers of triangles: `degenerate`, `duplicate`, `non_manifold`, `decimated`.

    Raises:
        InputError: Nothing is left.
    """
    if original.num_faces > most_faces:
        most_faces = max(round((1 - halved_share) * most_faces), 1)
    mesh, report = clean(original, min_component_share=0.0, max_faces=most_faces)
    taken_out = {name: report[f"{name}_faces"] for name in ("degenerate", "duplicate", "non_manifold", "decimated")}
    if any(taken_out.values()):
        counts = ", ".join(f"{count:,} {name.replace('_', '-')}" for name, count in taken_out.items() if count)
        print(f"refine: {mesh.num_faces:,} of {original.num_faces:,} triangles are left; {counts}", file=sys.stderr)
    return mesh, taken_out


def halved_where_seen(mesh: Mesh, data: Batches, count: int) -> Mesh:
    """The mesh with `count` triangles, where more pixels see it more: decimation goes by shape alone."""
    cast, pixel_counts = ray_caster(mesh), np.zeros(mesh.num_faces)
    indices = np.unique(np.linspace(0, data.num_views - 1, min(MOST_VIEWS, data.num_views)).astype(int))
    for target in tqdm([data.views[index] for index in indices], desc="seen triangles", unit="view", delay=QUIET):
        faces = faces_of_pixels(cast, target.camera)
        usable = np.asarray(decode(target, jnp.zeros(3)).valid)
        pixel_counts += np.bincount(faces[usable & (faces >= 0)], minlength=mesh.num_faces)
    halved = bisect_triangles(mesh, pixel_counts, count)
    print(f"refine: {halved.num_faces:,} triangles after halving those that most pixels see", file=sys.stderr)
    return halved


def _free_rows(task: _Task) -> np.ndarray:
    """`[N]` bool: the Gaussians of the run that show what the mesh does not. One line says how many."""
    assert task.result is not None
    cast, data = ray_caster(task.mesh), task.data
    targets = tqdm(data.views, desc="free Gaussians", unit="view", delay=QUIET)
    depths = (depth_of_mesh(cast, target.camera) for target in targets)
    depth_mode = task.result.depth_mode
    free = uncovered_gaussians(task.result.gaussians, data, depths, border(task.mesh), depth_mode=depth_mode)
    print(f"refine: {free.sum():,} of {len(free):,} Gaussians stay free, where there is no mesh", file=sys.stderr)
    return free


def _write(task: _Task, folder: Path, mixed: MixedGaussians, summary: dict[str, Any]) -> dict[str, Any]:
    """Write mesh, Gaussians and scores; return the report."""
    scene, effects = task.scene, task.trained.photo_effects
    refined, gaussians = to_mesh(mixed.bound), all_gaussians(mixed)
    for name in ("mesh.ply", "mesh.glb"):
        write_mesh(folder / name, scene.similarity.mesh_to_world(refined), scene.place)
    world = scene.similarity.gaussians_to_world(gaussians)
    write_gaussians(folder / "gaussians.ply", world, scene.place, cameras=scene.camera_centers)
    write_views(folder, scene.frames)
    write_photo_effects(folder, effects)
    scores = score_images(
        gaussians,
        scene.held_out_frames,
        task.trained.settings["model"]["background"],
        photo_effects=effects.with_near_appearances(scene.frames),
        align=align if effects.moves else None,
        depth_mode=DEPTH_OF_DISCS,
        observe=picture_keeper(folder),
    )
    counts = {"gaussians": mixed.num_gaussians, "bound": mixed.bound.num_gaussians, "free": mixed.num_free}
    report = {**scores, "vertices": refined.num_vertices, "faces": refined.num_faces, **counts, **summary}
    json_files.write(folder / "report.json", report)
    runs.update_manifest(folder, status="done", peak_gib=round(peak_memory() / 2**30, 2), **report)
    report_if_installed(folder)
    return report


class _RefinementJournal(Journal):
    """Logs and saves now and then."""

    def __init__(self, folder: Path, steps: int, step: int, seconds: float):
        super().__init__(folder, "refine", steps, step, seconds)
        self.recent: list[Array] = []  # PSNR of the views since the last line: single views differ by decibels

    def note(self, step: int, state: RefineState, metrics: Metrics, capacity: int) -> None:
        self.bar.update()
        self.recent.append(metrics.psnr)
        if step % LOGGED_EVERY == 0 or step == self.steps:
            self.log(step, metrics, psnr=sum(map(float, self.recent)) / len(self.recent))
            self.recent = []
        if step % SAVED_EVERY == 0 or step == self.steps:
            self.save(step, state, capacity)
