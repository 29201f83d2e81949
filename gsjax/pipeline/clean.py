"""Removal of giants and isolated clusters from Gaussians; a file that is cleaned in place can be restored."""

import filecmp
import os
import shutil
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians, take
from gsjax.io.files import atomic_path
from gsjax.io.gaussian_files import format_of, load_gaussians
from gsjax.io.georeference_files import stated_place
from gsjax.io.locks import lock_folder
from gsjax.io.temporary_files import sweep_beside
from gsjax.meshing.regions import given_numbers
from gsjax.pipeline.convert import given_box
from gsjax.rendering import gallery, outliers
from gsjax.report.figures import draw_panels
from gsjax.runs import is_run
from gsjax.runs.outputs import require_apart
from gsjax.runs.result import Result, open_result
from gsjax.scene.cameras import Camera, viewmat_centers
from gsjax.scene.colors import to_bytes

MOST_VIEWS = 24  # that are drawn
UNSEEN = -88.0  # A logit: the opacity is 0 in float32, and no other program is compiled.


def clean(
    source: str | Path,
    out: str | Path | None = None,
    *,
    scene: str | Path | None = None,
    crop_to_cameras: bool = False,
    box: Sequence[float] | None = None,
    sphere: Sequence[float] | None = None,
) -> dict[str, Any]:
    """Take out of Gaussians what is no part of the scene.

    *Giants* fill the picture of the nearest camera, or without cameras are as large as the scene. *Isolated* are small
    clusters apart from all others. *Cropped* is what is outside the given bounds.

    Args:
        source: Run folder, or a file of Gaussians.
        out: File to write, of any format. None: the file itself, of a run `gaussians.ply`.
        scene: Data set whose cameras to look from, where a file is given.
        crop_to_cameras: Keep only what is in the sphere that the cameras surround.
        box: `(x0, y0, z0, x1, y1, z1)`: keep only what is in it, world.
        sphere: `(x, y, z, radius)`: likewise.

    Returns:
        `gaussians` that are left; how many were taken out: `giants`, `isolated`, `cropped`; `original`, the file as it
        was (`FILE.original.ply`), None where another one was written; and `picture` (`OUT.cleaned.png`): before, after,
        and what was taken out, from where that differs most. None where nothing was taken out or no camera is known.

    Raises:
        InputError: A file cannot be read or written, was cleaned before, is of a run that another process works on, or
            nothing would be left.
    """
    source = Path(source)
    file = _file_of(source)
    out = file if out is None else Path(out)
    format_of(out)
    in_place = out.resolve() == file.resolve()
    if not in_place:
        require_apart(out, source, scene)
    with _kept_alone(out):
        if in_place and _original(out).exists() and not _is_unfinished(out):
            raise InputError(f"{out}: was cleaned before; `gsjax clean {out} --undo` restores {_original(out)}")
        box = None if box is None else given_box("box", box)
        sphere = None if sphere is None else _given_sphere(sphere)
        sweep_beside(out)
        whole = load_gaussians(source)
        result = open_result(source, scene=scene) if is_run(source) or scene is not None else None
        kinds = _outliers_by_kind(whole, result)
        is_outlier = kinds["giants"] | kinds["isolated"]
        is_outside = _outside(whole, box, sphere)
        if crop_to_cameras:
            is_outside |= _outside_cameras(source, result)
        kinds["cropped"] = is_outside & ~is_outlier
        is_removed = is_outlier | is_outside
        if is_removed.all():
            raise InputError(f"{source}: none of its {len(is_removed)} Gaussians would be left")
        place = stated_place(file)
        picture = _picture(result, is_removed, out) if result is not None and is_removed.any() else None
        original = _copy_original(out) if in_place and is_removed.any() else None
        if not in_place or original is not None:
            format_of(out).write(out, take(whole, ~is_removed), place)  # Last: from now on it is cleaned.
        counts = {kind: int(is_of_kind.sum()) for kind, is_of_kind in kinds.items()}
        return {"gaussians": int((~is_removed).sum()), **counts, "original": original, "picture": picture}


def undo(source: str | Path) -> dict[str, Any]:
    """Restore what `clean` has taken out of a file in place.

    Args:
        source: The file, or the run folder.

    Returns:
        `gaussians`, and how many of them came `back`.

    Raises:
        InputError: Nothing was taken out, or the file is another one by now.
    """
    file = _file_of(Path(source))
    with _kept_alone(file):
        if not _original(file).exists():
            raise InputError(f"{file}: nothing was taken out of it; there is no {_original(file)}")
        left, count = (load_gaussians(each).num_gaussians for each in (file, _original(file)))
        if left >= count and not _is_unfinished(file):
            raise InputError(f"{file}: is not the file any more that {_original(file)} became")
        os.replace(_original(file), file)
        return {"gaussians": count, "back": count - left}


def _file_of(source: Path) -> Path:
    if not source.exists():
        raise InputError(f"{source}: no such file or folder")
    return source / "gaussians.ply" if source.is_dir() else source


def _kept_alone(file: Path) -> AbstractContextManager[None]:
    """Keeps the run that a file is of for this process; any other file needs no such care."""
    return lock_folder(file.parent) if is_run(file.parent) else nullcontext()


def _given_sphere(sphere: Sequence[float]) -> list[float]:
    numbers = given_numbers("sphere", sphere, 4).tolist()
    if not numbers[3] > 0:
        raise InputError(f"sphere: its radius {numbers[3]:g} is not above 0")
    return numbers


def _original(file: Path) -> Path:
    return Path(f"{file}.original{file.suffix}")


def _copy_original(file: Path) -> str:
    original = _original(file)
    with atomic_path(original) as copy:
        shutil.copyfile(file, copy)
    return str(original)


def _is_unfinished(file: Path) -> bool:
    """Return whether a cleaning was stopped before the file changed."""
    return filecmp.cmp(file, _original(file), shallow=False)


def _outliers_by_kind(whole: Gaussians, result: Result | None) -> dict[str, np.ndarray]:
    """`[N]` bool by kind; where there are cameras, in their coordinates."""
    gaussians, centers = whole, None
    if result is not None:
        viewmats = [np.asarray(camera.viewmat, np.float64) for camera in _cameras(result)]
        gaussians, centers = result.gaussians, viewmat_centers(np.array(viewmats))
    means = np.asarray(gaussians.means, np.float64)
    is_giant = outliers.giants(means, np.exp(np.asarray(gaussians.log_scales, np.float64)), centers)
    is_isolated = np.zeros(len(means), bool)
    is_isolated[~is_giant] = outliers.cluster_sizes(means[~is_giant]) <= outliers.most_of_small(len(means))
    return {"giants": is_giant, "isolated": is_isolated}


def _cameras(result: Result) -> list[Camera]:
    """Those of the training views, evenly chosen."""
    training = [camera for camera, held_out in zip(result.cameras, result.held_out, strict=True) if not held_out]
    if not training:
        raise InputError(f"{result.source}: has no training views to look from")
    indices = np.unique(np.linspace(0, len(training) - 1, min(MOST_VIEWS, len(training))).astype(int))
    return [training[index] for index in indices]


def _outside(whole: Gaussians, box: Sequence[float] | None, sphere: Sequence[float] | None) -> np.ndarray:
    """`[N]` bool: whose means are outside the region."""
    means = np.asarray(whole.means, np.float64)
    outside = np.zeros(len(means), bool)
    if box is not None:
        outside |= ((means < box[:3]) | (means > box[3:])).any(axis=1)
    if sphere is not None:
        outside |= np.linalg.norm(means - sphere[:3], axis=1) > sphere[3]
    return outside


def _outside_cameras(source: Path, result: Result | None) -> np.ndarray:
    """`[N]` bool: whose means are outside the sphere that the cameras surround."""
    if result is None:
        raise InputError(f"{source}: comes without cameras, and a crop to cameras needs a run or a scene")
    focus = outliers.looked_at(_cameras(result))
    if focus is None:
        raise InputError(f"{source}: its cameras have no common focus; give a box or a sphere")
    middle, radius = focus
    return np.linalg.norm(np.asarray(result.gaussians.means, np.float64) - middle, axis=1) > radius


def _picture(result: Result, is_removed: np.ndarray, out: Path) -> str:
    """Before, after and what was taken out, from the view where that shows most."""
    cameras = _cameras(result)

    def rendered(hidden: np.ndarray, views: Sequence[Camera]) -> list[np.ndarray]:
        logits = np.where(hidden, np.float32(UNSEEN), np.asarray(result.gaussians.logit_opacities))
        gaussians = replace(result.gaussians, logit_opacities=logits)
        return [picture.colors for picture in gallery.pictures(gaussians, views, result.background, "plane")]

    before, after = rendered(np.zeros(len(is_removed), bool), cameras), rendered(is_removed, cameras)
    most = int(np.argmax([np.abs(a - b).mean() for a, b in zip(before, after, strict=True)]))
    (alone,) = rendered(~is_removed, [cameras[most]])
    panels = {"before": to_bytes(before[most]), "after": to_bytes(after[most]), "taken out": to_bytes(alone)}
    return str(draw_panels(panels, f"{out}.cleaned.png", columns=3))
