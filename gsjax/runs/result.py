"""What a finished run, or a file of Gaussians, offers to later stages: Gaussians, cameras, and where photos count."""

import math
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from tqdm import tqdm

from gsjax import runs
from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.io import json_files
from gsjax.io.gaussian_files import load_gaussians
from gsjax.io.georeference_files import stated_place
from gsjax.io.images import read_mask, write_image
from gsjax.io.json_shapes import check
from gsjax.io.scenes import load_scene
from gsjax.io.splits import NONE
from gsjax.rendering import DepthReading, gallery
from gsjax.rendering.gallery import Picture
from gsjax.runs import viewpoints
from gsjax.runs.photo_effects import with_moved_cameras
from gsjax.runs.records import SCENE
from gsjax.runs.relocation import relocated_images
from gsjax.runs.run import Run
from gsjax.runs.splits import with_split
from gsjax.scene import Frame, Scene, valid_pixels
from gsjax.scene import similarity as similarities
from gsjax.scene.cameras import Camera
from gsjax.scene.georeference import UNPLACED, Place
from gsjax.scene.similarity import IDENTITY, Similarity

BACKGROUND_COLORS = {
    "white": np.ones(3, np.float32),
    "black": np.zeros(3, np.float32),
    "random": np.zeros(3, np.float32),
}
"""Colour that pictures and scores are made over; a run trained on random ones is scored over black."""

DEPTH_OF_DISCS: DepthReading = "discs"  # The far side of a mesh shows through its discs, and is in any whole mean.
QUIET = 3.0  # Seconds of drawing that need no bar.


@dataclass(frozen=True)
class Result:
    """Gaussians and the views they were made from."""

    source: Path
    gaussians: Gaussians  # numpy
    cameras: tuple[Camera, ...]
    names: tuple[str, ...]
    held_out: tuple[bool, ...]
    valid: tuple[Callable[[], np.ndarray | None], ...]  # reads [H, W] bool, where the photo counts; None: everywhere
    background: np.ndarray  # [3], or as SH coefficients of the direction, see `gsjax.rendering.backdrop`
    depth_mode: DepthReading = "plane"  # as depth was read in training, or `DEPTH_OF_DISCS`, see `gsjax.rendering`
    similarity: Similarity = IDENTITY  # to Gaussians and cameras from the coordinates of the world
    place: Place = UNPLACED  # what is known of that world


def write_views(run: Path, frames: tuple[Frame, ...], skies: Mapping[str, np.ndarray] = MappingProxyType({})) -> None:
    """`cameras.json`: one record a view, world to camera, OpenCV axes, pixels; and the masks of the training views.

    A mask (`masks/0007.png`, 255 where the photo may be used) is written only for a view that has one, and its record
    names it: later stages need no photo to know what must not be seen. Only masked frames are read, one by one. Masks
    leave out skies, by name `[H, W]` bool. Views are in the order and the coordinates of the data set.

    Raises:
        InputError: A file cannot be written, or a frame not be read.
    """
    similarity = runs.read_similarity(run)
    records = [
        {
            "name": f.name,
            "width": f.width,
            "height": f.height,
            "viewmat": similarity.viewmat_to_world(f.viewmat),
            "K": f.K,
            "held_out": f.held_out,
            "mask": None if f.held_out else _written_mask(run, f"masks/{index:04d}.png", f, skies.get(f.name)),
        }
        for index, f in enumerate(frames)
    ]
    json_files.write(run / "cameras.json", records)


def open_result(source: str | Path, *, scene: str | Path | None = None) -> Result:
    """A run folder; or any file of Gaussians, with the cameras of `scene` or with cameras placed around it.

    Files are those of `gsjax.io.gaussian_files`, by their suffixes.

    Raises:
        InputError: It is neither, or unfinished, or unreadable.
    """
    source = Path(source)
    gaussians = load_gaussians(source)
    if source.is_dir():
        return _result_of_run(source, gaussians)
    return _seen_from_around(source, gaussians) if scene is None else _seen_from_scene(source, gaussians, scene)


def _result_of_run(source: Path, gaussians: Gaussians) -> Result:
    run = Run(source)
    settings, learned, records = run.settings, run.photo_effects.background, run.views
    check(source / "config.json", settings, {"model": {"background": str, "depth_mode": str}})
    return Result(
        source,
        run.similarity.gaussians_to_local(gaussians),
        cameras=tuple(recorded_camera(record, run.similarity) for record in records),
        names=tuple(record["name"] for record in records),
        held_out=tuple(bool(record["held_out"]) for record in records),
        valid=tuple(partial(_read_mask, source, record) for record in records),
        background=BACKGROUND_COLORS[settings["model"]["background"]] if learned is None else learned,
        depth_mode=DEPTH_OF_DISCS if run.is_refinement else settings["model"]["depth_mode"],
        similarity=run.similarity,
        place=run.place,
    )


def _seen_from_around(source: Path, gaussians: Gaussians) -> Result:
    if not gaussians.num_gaussians:
        raise InputError(f"{source}: holds no Gaussians, there is nothing to show")
    similarity = similarities.of_points(np.asarray(gaussians.means))
    gaussians = similarity.gaussians_to_local(gaussians)
    cameras = viewpoints.cameras_around(gaussians)
    return Result(
        source,
        gaussians,
        cameras,
        names=tuple(f"around_{index:02d}" for index in range(len(cameras))),
        held_out=(False,) * len(cameras),
        valid=(lambda: None,) * len(cameras),
        background=BACKGROUND_COLORS["black"],
        similarity=similarity,
        place=stated_place(source),
    )


def _seen_from_scene(source: Path, gaussians: Gaussians, scene: str | Path) -> Result:
    loaded = load_scene(scene)
    frames = loaded.frames
    return Result(
        source,
        loaded.similarity.gaussians_to_local(gaussians),
        cameras=tuple(map(frame_camera, frames)),
        names=tuple(f.name for f in frames),
        held_out=tuple(f.held_out for f in frames),
        valid=tuple(partial(valid_pixels, f) for f in frames),
        background=BACKGROUND_COLORS["black"],
        similarity=loaded.similarity,
        place=loaded.place,
    )


def training_pictures(
    result: Result, gaussians: Gaussians, background: np.ndarray, *, with_owners: bool = False
) -> tuple[list[Camera], Iterator[Picture]]:
    """Training cameras, and what `gaussians` show there: nothing where photos are masked.

    The background is that of `gsjax.rendering.backdrop`. With owners the pictures hold the Gaussian that each pixel
    hits, which the level set requires.

    Raises:
        InputError: There is no training view; or, as the pictures are drawn, a mask cannot be used.
    """
    indices = [index for index, held_out in enumerate(result.held_out) if not held_out]
    if not indices:
        raise InputError(f"{result.source}: has no training views to look from")
    cameras = [result.cameras[index] for index in indices]
    views = gallery.pictures(gaussians, cameras, background, result.depth_mode, with_owners=with_owners)
    pictures = tqdm(views, total=len(cameras), desc="views", unit="view", delay=QUIET)
    return cameras, gallery.mask_pictures(pictures, (result.valid[index]() for index in indices))


def scene_of_run(folder: Path, *, zoom: float = 1.0, scene: str | Path | None = None) -> Scene:
    """The data set of a finished run, loaded as it was trained on: with its split, whatever became of the list of it.

    Cameras that training moved are where it left them; photos that it left out are left out. A line names photos that
    the data set has no more. Photos are `zoom` times larger than in training; `scene` is where the data set is now.

    Raises:
        InputError: It is no run folder, its data set cannot be used any more, or its photos are too small for `zoom`.
    """
    run = Run(folder)
    check(folder / "manifest.json", run.manifest, SCENE)
    check(folder / "config.json", run.settings, {"photos": {"masks": str}})
    if not 0 < zoom < math.inf:
        raise InputError(f"zoom={zoom:g} is not a number above 0")
    downscale = run.downscale / zoom
    if downscale < 1:
        reduced = f"reduced by {run.downscale:g}" if run.downscale > 1 else "as they are"
        raise InputError(f"{folder}: was trained on photos {reduced}; there are none {zoom:g} times larger")
    root = run.manifest["scene"] if scene is None else scene
    if scene is None and not os.path.isdir(root):
        raise InputError(
            f"{folder}: its data set is no longer in {root}; `gsjax train --out {folder} --resume --scene FOLDER` sets"
            " where it is now"
        )
    loaded = load_scene(
        root,
        downscale=downscale,
        folder_masks=run.settings["photos"]["masks"],
        images=relocated_images(run, root),
        hold_out=NONE,
        similarity=run.similarity,
        place=run.place,
    )
    names = {record["name"] for record in run.views}
    left_out = {name for name in run.split if name not in names}
    frames = tuple(frame for frame in loaded.frames if frame.name not in left_out)
    split = {record["name"]: run.split.get(record["name"], bool(record["held_out"])) for record in run.views}
    loaded = with_split(replace(loaded, frames=frames), split, run=folder)
    return replace(loaded, frames=with_moved_cameras(loaded.frames, run.photo_effects.moves))


def frame_camera(frame: Frame) -> Camera:
    """The camera of a loaded frame, numpy."""
    return Camera(frame.viewmat, frame.K, frame.width, frame.height)


def recorded_camera(record: dict[str, Any], similarity: Similarity) -> Camera:
    """The camera of a record of `cameras.json`, numpy, in the run's own coordinates."""
    viewmat = similarity.viewmat_to_local(np.asarray(record["viewmat"])).astype(np.float32)
    K = np.asarray(record["K"], np.float32)
    return Camera(viewmat, K, record["width"], record["height"])


def _written_mask(run: Path, name: str, frame: Frame, sky: np.ndarray | None) -> str | None:
    valid = valid_pixels(frame)
    if sky is not None:
        valid = ~sky if valid is None else valid & ~sky
    if valid is None or valid.all():
        return None
    write_image(run / name, np.where(valid, np.uint8(255), np.uint8(0)))
    return name


def _read_mask(run: Path, record: dict[str, Any]) -> np.ndarray | None:
    name = record.get("mask")
    if name is None:
        return None
    valid = read_mask(run / name) > 127
    if valid.shape != (record["height"], record["width"]):
        size = f"{valid.shape[1]}x{valid.shape[0]}"
        raise InputError(f"{run / name}: mask is {size} but its view {record['width']}x{record['height']}")
    return valid
