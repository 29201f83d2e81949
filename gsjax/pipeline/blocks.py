"""A large scene in blocks: each is trained alone, on any machine, and all are merged into one run folder."""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gsjax import config, runs
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians, concatenate, take
from gsjax.io import json_files
from gsjax.io.files import atomic_folder, atomic_path, require_empty
from gsjax.io.gaussian_files import load_gaussians
from gsjax.io.ply import write_gaussians
from gsjax.io.scenes import list_photos, load_scene
from gsjax.metrics.photos import score_images
from gsjax.pipeline.train import train
from gsjax.planning.blocks import FEWEST, Cell, cut, directions, photos_of
from gsjax.planning.sizes import at_size, chosen_downscale
from gsjax.report.page import report_if_installed
from gsjax.report.view_pictures import picture_keeper
from gsjax.runs.result import write_views
from gsjax.runs.splits import split_of
from gsjax.scene import Scene
from gsjax.scene.cameras import viewmat_centers
from gsjax.settings import AUTO, NONE, Photos, Settings
from gsjax.training.plan import plan

PLAN = "blocks.json"
_CELL = {"low": [(None, float), 2], "high": [(None, float), 2], "photos": [str]}
_SHAPE = {"scene": str, "settings": {str: object}, "downscale": float, "directions": [[float, 3], 2], "cells": [_CELL]}


@dataclass(frozen=True)
class Blocks:
    """The division of a scene."""

    folder: Path
    scene: Path
    settings: Settings  # of every block
    directions: np.ndarray  # [2, 3] unit, world: the axes of the cells
    cells: tuple[Cell, ...]
    photos: tuple[tuple[str, ...], ...]  # names, of each cell

    def run(self, number: int) -> Path:
        """Return the run folder of a block, counted from 1."""
        return self.folder / f"block_{number}"

    def listed(self, number: int) -> str:
        """Write and return the file that lists its photos."""
        file = self.folder / f"block_{number}.txt"
        with atomic_path(file) as temporary:
            temporary.write_text("".join(f"{name}\n" for name in self.photos[number - 1]), encoding="utf-8")
        return str(file)


def blocks(
    scene: str | Path,
    out: str | Path,
    settings: Settings | Mapping[str, Any],
    count: int,
    *,
    only: Sequence[int] = (),
) -> dict[str, Any]:
    """Divide a scene by its camera positions, train the blocks that are not trained yet, and merge all.

    A second call resumes. Several machines share one folder, each with blocks of its own.

    Args:
        scene: Folder of the data set.
        out: Folder for everything: `blocks.json`, the plan; of every block the names of its photos, `block_1.txt`, and
            its run folder, `block_1`; `run`, the merged one, which every other command reads.
        settings: Of each block, which has as many Gaussians and steps. Effects of photography are not searched: those
            of two blocks would differ at their border.
        count: Of blocks.
        only: Numbers of blocks to train, from 1; none: all.

    Returns:
        `blocks`, which are `trained`, and the merged `run` with its figures (None while blocks are left).

    Raises:
        InputError: The scene cannot be divided so, a block cannot be trained, or `out` was begun with something else.
    """
    planned = _planned(Path(scene), Path(out).resolve(), _without_effects(config.as_record(Settings, settings)), count)
    for number in only:
        if not 1 <= number <= count:
            raise InputError(f"only={number}: there are blocks 1 to {count}")
    for number in only or range(1, count + 1):
        run = planned.run(number)
        if not runs.is_finished(run):
            print(f"blocks: {number} of {count}", file=sys.stderr)
            train(scene, run, planned.settings.replace(photos={"subset": planned.listed(number)}), resume=run.exists())
    trained = [number for number in range(1, count + 1) if runs.is_finished(planned.run(number))]
    merged = planned.folder / "run" if len(trained) == count else None
    if merged is not None and not runs.is_finished(merged):
        _merge(planned, merged)
    figures = {} if merged is None else json_files.read(merged / "manifest.json", {})
    scores = {name: figures.get(name) for name in ("gaussians", "psnr", "ssim")}
    return {"blocks": count, "trained": len(trained), "run": None if merged is None else str(merged), **scores}


def _without_effects(settings: Settings) -> Settings:
    if settings.photos.subset is not None:
        raise InputError(f"photos.subset={settings.photos.subset}: each block chooses its photos")
    if settings.effects.sky is not None:
        raise InputError(
            f"sky={settings.effects.sky}: the colours behind one block would not fit those behind the next"
        )
    if settings.effects.names not in (AUTO, NONE):
        raise InputError(
            f"effects={settings.effects.names}: what blocks find of effects would not fit at their borders"
        )
    return settings.replace(effects={"names": NONE})


def _planned(scene: Path, out: Path, settings: Settings, count: int) -> Blocks:
    """Read the plan in the folder, which must have the same arguments, or write a new one."""
    file, request = out / PLAN, {"scene": str(scene.resolve()), "settings": json_files.plain(config.to_dict(settings))}
    if not file.exists():
        require_empty(out)
        json_files.write(file, request | _divided(scene, settings.photos, count))
    record = json_files.read(file, _SHAPE)
    for name, value in {**request, "blocks": count}.items():
        if {**record, "blocks": len(record["cells"])}[name] != value:
            raise InputError(f"{out}: was begun with another {name}; choose another folder")
    cells = tuple(Cell(_limits(cell["low"], -math.inf), _limits(cell["high"], math.inf)) for cell in record["cells"])
    sized = settings.replace(photos={"downscale": record["downscale"]})
    photos = tuple(tuple(cell["photos"]) for cell in record["cells"])
    return Blocks(out, scene, sized, np.array(record["directions"]), cells, photos)


def _limits(limits: Sequence[float | None], beyond: float) -> tuple[float, float]:
    first, second = (beyond if limit is None else limit for limit in limits)
    return first, second


def _divided(scene: Path, photos: Photos, count: int) -> dict[str, Any]:
    """Return the plan's size of photos, cells, and photos of each cell."""
    loaded = load_scene(scene, hold_out=photos.hold_out, images=photos.images)
    listed = list_photos(scene, photos.images)
    names = [photo.name for photo in listed]
    centers = viewmat_centers(np.stack([loaded.place.viewmat_to_world(photo.viewmat) for photo in listed]))
    along = directions(centers)
    places = centers @ along.T
    cells, points = cut(places, count), _points_of_photos(loaded, names, along)
    held_out = {frame.name for frame in loaded.held_out_frames}
    records = []
    for number, cell in enumerate(cells, 1):
        block = np.array(names)[photos_of(cell, places, points)].tolist()
        if (left := len(set(block) - held_out)) < FEWEST:
            raise InputError(f"blocks={count}: block {number} would have {left} photos to train on; make fewer")
        records.append({"low": cell.low, "high": cell.high, "photos": block})
    return {"downscale": chosen_downscale(photos, loaded.frames), "directions": along, "cells": records}


def _points_of_photos(scene: Scene, names: Sequence[str], along: np.ndarray) -> list[np.ndarray]:
    """`[P_v, 2]` places of the points that each photo sees; none without tracks."""
    if scene.tracks is None:
        return [np.empty((0, 2))] * len(names)
    tracks, places = scene.tracks(), scene.similarity.points_to_world(scene.points) @ along.T
    numbers = {name: number for number, name in enumerate(tracks.names)}
    return [places[tracks.point[tracks.photo == numbers.get(name, -1)]] for name in names]


def _merge(planned: Blocks, out: Path) -> None:
    """Write the run folder of all blocks: of each, the Gaussians whose means are in its own cell."""
    settings, count = planned.settings, len(planned.cells)
    parts = [_own(planned, number) for number in range(1, count + 1)]
    gaussians = concatenate(parts)
    loaded, downscale, photos_line = at_size(planned.scene, settings.photos, count * settings.schedule.steps)
    record = replace(plan(settings), downscale=downscale).record()
    with atomic_folder(out) as run:
        runs.create(
            run,
            config.to_dict(settings),
            scene=planned.scene,
            seed=settings.seed,
            similarity=loaded.similarity,
            place=loaded.place,
            plan=record,
            split=split_of(loaded.frames),
        )
        write_gaussians(run / "gaussians.ply", gaussians, loaded.place, cameras=loaded.camera_centers)
        write_views(run, loaded.frames)
        scores = score_images(
            loaded.similarity.gaussians_to_local(gaussians),
            loaded.held_out_frames,
            settings.model.background,
            depth_mode=settings.model.depth_mode,
            observe=picture_keeper(run),
        )
        figures = {"gaussians": gaussians.num_gaussians, "steps": count * settings.schedule.steps, **scores}
        summary = f"{count} blocks of {', '.join(f'{part.num_gaussians:,}' for part in parts)} Gaussians"
        runs.update_manifest(run, status="done", photos=photos_line, blocks=summary, **figures)
    report_if_installed(out)


def _own(planned: Blocks, number: int) -> Gaussians:
    whole = load_gaussians(planned.run(number))
    places = np.asarray(whole.means, np.float64) @ planned.directions.T
    return take(whole, planned.cells[number - 1].holds(places))
