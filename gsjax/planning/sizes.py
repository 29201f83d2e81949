"""The size at which a run reads its photos: chosen and printed."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from gsjax.errors import InputError
from gsjax.io.scenes import load_scene
from gsjax.io.splits import NONE
from gsjax.rendering.engine import computes_on_cpu
from gsjax.runs.run import Run
from gsjax.runs.splits import with_split
from gsjax.scene import Frame, Scene, extent
from gsjax.settings import Photos


def at_size(
    scene: str | Path,
    photos: Photos,
    steps: int,
    downscale: float | None = None,
    *,
    run: Run | None = None,
) -> tuple[Scene, float, str]:
    """The data set at the size that a run reads, how many times smaller that is, and the line that says it.

    A `downscale` that was chosen before stays. A `run` that was trained on the same data set gives its split,
    coordinates and world.
    """
    split = run.split if run else {}
    opened = partial(
        load_scene,
        scene,
        folder_masks=photos.masks,
        images=photos.images,
        hold_out=NONE if split else photos.hold_out,
        photos=None if split else photos.subset,
        similarity=run and run.similarity,
        place=run and run.place,
    )

    def taken_photos(scene: Scene) -> Scene:
        return with_split(scene, split, run=run.folder) if run and split else scene

    full_size = taken_photos(opened())
    factor = chosen_downscale(photos, full_size.frames) if downscale is None else downscale
    loaded = full_size if factor == 1 else taken_photos(opened(downscale=factor))
    return loaded, factor, size_line(steps, full_size.frames, loaded.frames)


def training_extent(scene: Scene) -> float:
    """The camera extent of the photos that training may see, scene units.

    Raises:
        InputError: There is none or one, or all of them were taken from one place.
    """
    frames = scene.train_frames
    if not frames:
        raise InputError(f"{scene.root}: all {len(scene.frames)} photos are held out, none is left to train on")
    size = extent(frames)
    if len(frames) == 1 and len(scene.frames) > 1:
        raise InputError(
            f"{scene.root}: of its {len(scene.frames)} photos one is left to train on, which is too few;"
            " photos.hold_out=none trains on all"
        )
    if size <= 0:
        raise InputError(
            f"{scene.root}: all {len(frames)} training cameras are at one place, nothing can be reconstructed"
        )
    return size


def chosen_downscale(photos: Photos, frames: Sequence[Frame], *, on_cpu: bool | None = None) -> float:
    """How many times smaller the photos become: what the user said, else what the largest of them needs.

    Its longer side is reduced to `photos.longest_side` (1600 pixels, as 3DGS does), and on a CPU (None: as jax says)
    its area to `photos.cpu_pixels` where the preset has that.
    """
    if photos.downscale is not None:
        return photos.downscale
    factor = max(1.0, max(max(f.width, f.height) for f in frames) / photos.longest_side)
    on_cpu = computes_on_cpu() if on_cpu is None else on_cpu
    if on_cpu and photos.cpu_pixels is not None:
        factor = max(factor, math.sqrt(max(f.width * f.height for f in frames) / photos.cpu_pixels))
    return round(factor, 4)


def size_line(steps: int, originals: Sequence[Frame], used: Sequence[Frame]) -> str:
    """One line for the user: how many photos, at what size and why, and how many steps."""
    largest, reduced = (max(frames, key=lambda f: f.width * f.height) for frames in (originals, used))
    line = f"{len(used)} photos at {reduced.width}x{reduced.height}"
    if (largest.width, largest.height) != (reduced.width, reduced.height):
        line += f" (taken at {largest.width}x{largest.height}; photos.downscale=1 keeps that)"
    return f"{line}, {steps:,} steps"
