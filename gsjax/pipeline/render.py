"""Pictures of a run: colour, depth and normals of its views or from a circle around the scene."""

import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from tqdm import tqdm

from gsjax.colors import to_bytes
from gsjax.errors import InputError
from gsjax.io.files import make_folder
from gsjax.io.images import write_image
from gsjax.rendering import gallery
from gsjax.report.pictures import depth_picture, surface_picture
from gsjax.runs.outputs import require_apart
from gsjax.runs.result import open_result
from gsjax.runs.viewpoints import camera_circle


def render(run: str | Path, out: str | Path, *, which: Literal["all", "held_out", "turntable"] = "all") -> Path:
    """Write NAME_color.png, NAME_depth.png and NAME_normal.png for each chosen view, see `picture_stems`.

    Args:
        run: Run folder, or a file of Gaussians.
        out: Folder for the pictures.
        which: Every view of the run, the held-out ones, or a circle around the scene.

    Returns:
        `out`.

    Raises:
        InputError: The run cannot be read or the pictures cannot be written.
    """
    require_apart(out, run)
    result = open_result(run)
    if which == "turntable":
        cameras = camera_circle(result.gaussians, result.cameras)
        names = [f"turn_{i:03d}" for i in range(len(cameras))]
    else:
        chosen = [i for i, held_out in enumerate(result.held_out) if held_out or which == "all"]
        if not chosen:
            raise InputError(f"{run}: has no held-out views to render")
        stems = picture_stems(result.names)
        cameras, names = [result.cameras[i] for i in chosen], [stems[i] for i in chosen]
    out = make_folder(out)
    shown = gallery.pictures(result.gaussians, cameras, result.background, result.depth_mode)
    for name, camera, picture in tqdm(
        zip(names, cameras, shown, strict=True), total=len(cameras), desc="render", unit="view"
    ):
        write_image(out / f"{name}_color.png", to_bytes(picture.colors))
        write_image(out / f"{name}_depth.png", depth_picture(picture.depth))
        write_image(out / f"{name}_normal.png", surface_picture(picture.depth, camera))
    return out


def picture_stems(names: Sequence[str]) -> list[str]:
    """What files of views are called, each otherwise: by the photo's name without its suffix where that tells."""
    whole = [name.replace("/", "_") for name in names]
    short = [os.path.splitext(name)[0] for name in whole]
    alike = Counter(short)
    stems = [brief if alike[brief] == 1 else name for brief, name in zip(short, whole, strict=True)]
    alike = Counter(stems)
    return [stem if alike[stem] == 1 else f"{stem}_{index}" for index, stem in enumerate(stems)]
