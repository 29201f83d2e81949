"""The request for a training run, its data set, and the photos, maps and effects that its steps read."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jax import Array
from jax.sharding import Mesh
from tqdm import tqdm

from gsjax import config, runs
from gsjax.effects.simulation import Effects
from gsjax.errors import InputError
from gsjax.io import normal_folders
from gsjax.planning import sparse_view_validation
from gsjax.planning.depth_supervision import measured_depth, stereo_supervision
from gsjax.planning.effect_validation import EffectValidation
from gsjax.planning.effects import ChosenEffects, Inspection, choose_effects, inspect_photos
from gsjax.planning.memory import MemoryFit, fit_to_memory
from gsjax.planning.sizes import at_size, training_extent
from gsjax.planning.sky_masks import read_sky_masks
from gsjax.planning.sparse_views import ENTRY, Decision, Gain, for_sparse_views
from gsjax.planning.start import first_state, with_given_points, with_stereo_points
from gsjax.planning.warm_start import pieces_record, require_pieces
from gsjax.rendering.engine import engine_here
from gsjax.runs.normal_source import NormalSource, note_normals
from gsjax.runs.processes import is_first, same_everywhere
from gsjax.runs.run import Run
from gsjax.runs.splits import Split, require_photos_of_effects, split_of
from gsjax.scene import Keep, Scene, preload
from gsjax.settings import AUTO, Settings
from gsjax.stereo import StereoMaps, depths_of_photos
from gsjax.training.data_parallel import Devices, device_mesh
from gsjax.training.densification.rules import DENSIFICATION_RULES, DensificationRule, rule_named
from gsjax.training.loop import Depths
from gsjax.training.plan import Plan, check_terms, plan
from gsjax.training.state import TrainState
from gsjax.training.terms import Term


@dataclass(frozen=True)
class RunRequest:
    """The request for a run, and the run that it continues."""

    scene: str | Path
    out: Path
    settings: Settings
    plan: Plan  # before any photo is inspected
    effects: Effects  # the user's own
    pieces: dict[str, Any]  # record of the user's own terms, effects and rule
    resumed: Run | None  # the run in `out`
    warm_start: Path | None
    origin: Run | None  # in whose coordinates training starts: `resumed`, or that of the warm start
    mesh: Mesh | None

    @property
    def has_checkpoint(self) -> bool:
        """Whether there is a checkpoint to start from."""
        return self.origin is not None and runs.latest_checkpoint(self.origin.folder) is not None

    def decided(self, entry: str) -> dict[str, Any] | None:
        """What the manifest of `origin` records of a decision, which is not made again."""
        return self.origin and self.origin.manifest.get(entry)


def plan_run(
    scene: str | Path,
    out: Path,
    settings: Settings,
    terms: Mapping[str, Term | Callable[..., Array]],
    densification: DensificationRule | None,
    effects: Effects,
    *,
    resume: bool,
    warm_start: Path | None,
    devices: Devices,
) -> RunRequest:
    """Plan a run by its settings, and by the decisions that a resumed run made at its start.

    Raises:
        InputError: The folder is not free or holds no run to resume, or a weight, a term or the devices cannot be used.
    """
    if not resume:
        runs.require_free(out)
    resumed = Run.open(out) if resume and is_first() and runs.can_resume(out) else None
    pieces = pieces_record(terms, densification, effects)
    if resumed:
        config.parse(Settings, resumed.settings, where=str(out / "config.json"))
        runs.require_scene(out, scene)
        require_pieces(resumed, pieces)
    mesh = device_mesh(devices, settings.schedule.views_per_step)
    planned = plan(settings, terms, densification=densification)
    if resumed and "max_gaussians" in resumed.plan:  # Memory may have allowed fewer than were requested.
        planned = replace(planned, max_gaussians=resumed.plan["max_gaussians"])
    if settings.supervision.normals is not None:
        normals = resumed.plan["normals"] if resumed else normal_folders.find(scene, settings.supervision.normals)
        planned = replace(planned, normals=normals)
    origin = resumed or (None if warm_start is None else Run(warm_start))
    return RunRequest(scene, out, settings, planned, effects, pieces, resumed, warm_start, origin, mesh)


@dataclass(frozen=True)
class StepInputs:
    """The photos, maps and effects that the steps read."""

    scene: Scene  # its photos in memory or on the disk, without the blurred ones
    split: Split  # of all photos of the data set
    start: Scene  # from whose points the Gaussians start
    extent: float  # of the training cameras, scene units
    plan: Plan  # for these photos, effects and this machine
    keep: Keep  # where photos and maps are
    normals: NormalSource
    depths: Depths | None  # measured, or of stereo
    stereo: StereoMaps  # that supervise the run
    effects: ChosenEffects
    notes: dict[str, Any]  # entries of the manifest


def prepare(request: RunRequest) -> StepInputs:
    """Read the data set at the size of the run, its photos and maps as far as memory allows; choose the effects."""
    settings, maps = request.settings, request.settings.supervision
    loaded, split, downscale, photos_line = _load(request)
    memory, sparse = _size(request, loaded)
    scene = read_photos(loaded, memory.keep)
    report(*_opening_lines(memory.plan, settings.schedule.dropout, photos_line), sparse and sparse.line(memory.plan))
    inspected = inspect_photos(settings.effects.names, scene)
    scene = inspected.scene
    extent = training_extent(scene)
    measured, start = measured_depth(scene, maps), with_given_points(scene, settings.model.points)
    own_maps = request.out if request.resumed else None
    stereo = stereo_supervision(scene, maps, own_maps, vanilla=settings.schedule.vanilla)
    depths = measured.depths if measured else stereo.depths(scene.train_frames)
    planned = memory.plan if depths else memory.plan.without("measured")
    stereo_line = stereo.line if stereo.maps else None
    report(measured and f"depth {measured.line}", stereo.fault, stereo_line)
    if not stereo.maps and planned.normals is None and "normals" in planned.needs:
        report("no maps of normals (supervision.normals): the rendered depth replaces a network")
    normals = _normal_source(request, planned, scene, stereo.normals, memory.keep)
    if not request.has_checkpoint:
        start, lines = with_stereo_points(start, planned, lambda: stereo.swept or depths_of_photos(scene))
        report(*lines)
    effects = _choose_effects(request, planned, inspected, start, extent, downscale).with_own(request.effects)
    notes = {
        "photos": photos_line,
        "memory": "; ".join(memory.lines),
        ENTRY: sparse and asdict(sparse),
        "stereo": stereo_line,
        "effects": effects.evidence,
        **request.pieces,
    }
    notes = {name: note for name, note in notes.items() if note}
    planned = replace(planned.with_effects(effects.names), downscale=downscale)
    return StepInputs(scene, split, start, extent, planned, memory.keep, normals, depths, stereo.maps, effects, notes)


def _normal_source(
    request: RunRequest, planned: Plan, scene: Scene, stereo: Mapping[str, np.ndarray], keep: Keep
) -> NormalSource:
    maps = request.settings.supervision
    return NormalSource(
        request.out,
        planned.normals,
        maps.normal_axes,
        scene.train_frames,
        request.settings.model.depth_mode,
        maps.normal_gate,
        stereo=stereo,
        keep=keep,
        notify=partial(note_normals, request.out),
    )


def _load(request: RunRequest) -> tuple[Scene, Split, float, str]:
    """The data set at the size of the run, its photos unread; its split, how many times smaller, and the line of it.

    The run's own terms are tried on the sizes of its photos.
    """
    downscale = request.resumed and request.resumed.plan["downscale"]
    scene, downscale, line = at_size(
        request.scene, request.settings.photos, request.plan.steps, downscale, run=request.origin
    )
    split = (request.origin and request.origin.split) or split_of(scene.frames)
    if request.origin and request.has_checkpoint:
        require_photos_of_effects(scene, split, request.origin.manifest, run=request.origin.folder)
    check_terms(request.plan, scene.train_frames)
    return scene, split, downscale, line


def _size(request: RunRequest, scene: Scene) -> tuple[MemoryFit, Decision | None]:
    """The plan for so many photos, so far apart, in this machine's memory."""

    def validate(change: Callable[[Plan], Plan]) -> Gain:
        return same_everywhere(sparse_view_validation.gain(scene, request.settings, change))

    planned, sparse = for_sparse_views(
        request.plan,
        scene,
        request.settings.schedule,
        validate=None if request.origin else validate,
        before=request.decided(ENTRY),
        may_lower=request.resumed is None,
    )
    may_lower = request.mesh is None and request.resumed is None
    memory = fit_to_memory(planned, scene.frames, request.out, may_lower=may_lower)
    report(*memory.lines)
    return memory, sparse


def read_photos(scene: Scene, keep: Keep) -> Scene:
    """The scene with its photos in memory or on the disk: a damaged one is found before the run begins."""
    photos = tqdm(scene.frames, desc="photos", unit="photo", leave=False)
    scene = replace(scene, frames=tuple(preload(frame, keep) for frame in photos))
    masks = [frame.pixels().valid for frame in scene.train_frames]
    if not any(mask is None or mask.any() for mask in masks):
        raise InputError(f"{scene.root}: its masks leave no pixel of any photo; what is not 0 in a mask is used")
    return scene


def _opening_lines(planned: Plan, dropout: float, photos_line: str) -> list[str]:
    """Where the run computes and with which engine, on what, and what of the plan may surprise."""
    engine = engine_here()
    lines = [f"on {engine.device} with the {engine.name} rasterizer", photos_line]
    if dropout:
        lines.append(f"every step leaves out {dropout:.0%} of the Gaussians")
    if any(phase.rule is DENSIFICATION_RULES["adc"] for phase in planned.phases):
        lines.append(f"densification stops at max_gaussians={planned.max_gaussians:,}; 3DGS has no such bound")
    return lines


def _choose_effects(
    request: RunRequest, planned: Plan, inspected: Inspection, start: Scene, extent: float, downscale: float
) -> ChosenEffects:
    """The effects that the settings name, or that photos show and validation runs confirm."""
    settings, scene = request.settings, inspected.scene
    sized = settings.replace(model={"max_gaussians": planned.max_gaussians})

    def initial(short: Settings, optimizer: Any, effects: Effects) -> TrainState:
        return first_state(start, short.model, rule_named(short.density.rule), optimizer, effects)

    validate = EffectValidation(sized, planned, scene.train_frames, extent, initial)
    return choose_effects(
        settings.effects.names,
        planned,
        scene,
        lambda *how: same_everywhere(validate(*how)),
        inspected,
        skies=read_sky_masks(scene, settings.effects.sky, settings.photos.images, downscale),
        with_sky=settings.effects.sky == AUTO,
        before=request.decided("effects"),
    )


def report(*lines: str | None) -> None:
    """Print lines for the user; of None, nothing."""
    for line in filter(None, lines):
        print(f"train: {line}", file=sys.stderr)
