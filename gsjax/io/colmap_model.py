"""A COLMAP model: where it is, and what its files say.

They are read here because pycolmap 4.2 reads past the end of a truncated file, drops every second image of an
`images.txt` without keypoint lines, ends names at their first space, and shears the scene by a quaternion that is not
of unit length. `rigs` and `frames` are not read: they say nothing that `images` does not.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.bad_items import leave_out, leave_out_rows, read_usable
from gsjax.io.colmap_files import PosedImage, count_images, read_cameras, read_images
from gsjax.io.colmap_files import read_points as read_colmap_points
from gsjax.io.lenses import Lens, check_lens
from gsjax.io.messages import print_once
from gsjax.io.ply import read_points
from gsjax.scene.similarity import is_float32

PLACES = ("sparse/*", "sparse", "colmap/sparse/*", ".")  # Where models are looked for.
_SUFFIXES = ".bin", ".txt"
_SHORTEST_QUAT = 1e-6


@dataclass(frozen=True)
class Model:
    """What a COLMAP model says."""

    cameras: dict[int, Lens]
    images: tuple[PosedImage, ...]  # by name
    point_ids: np.ndarray  # [P] int64, ascending
    points: np.ndarray  # [P, 3] float64 world
    point_colors: np.ndarray  # [P, 3] uint8


def find_model(root: Path) -> Path | None:
    """The folder under `root` that holds a COLMAP model's cameras file, or None.

    Of several models, the one with the most photos is taken, and a line says so.
    """
    folders: dict[str, Path] = {}  # by where links lead
    for place in PLACES:
        for folder in _folders(root, place):
            if _suffix(folder):
                folders.setdefault(os.path.realpath(folder), folder)
    models = list(folders.values())
    return _largest(root, models) if len(models) > 1 else next(iter(models), None)


def read_model(folder: Path) -> Model:
    """Reads cameras, images and, where there are any, points.

    Quaternions are made unit. Points may be in `points3D.ply` alone, as 3DGS writes it. Photos without a finite pose or
    a usable camera are left out, and so are points that are not finite (`gsjax.io.bad_items`).

    Raises:
        InputError: A file is missing, truncated or contradicts another; a camera model is unknown; or too few photos
            or points can be used.
    """
    suffix = _suffix(folder) or ".bin"

    files = {part: folder / f"{part}{suffix}" for part in ("cameras", "images", "points3D")}
    for part in ("cameras", "images"):
        if not files[part].is_file():
            raise InputError(f"{files[part]}: missing from the COLMAP model")
    cameras = read_cameras(files["cameras"])
    if not cameras:
        raise InputError(f"{files['cameras']}: no camera in it")
    images = sorted(read_images(files["images"]), key=lambda image: image.name)
    posed = _posed_images(images, cameras, files)
    if files["points3D"].is_file():
        return Model(cameras, posed, *_cloud(files["points3D"]))
    if (folder / "points3D.ply").is_file():
        points, colors = read_points(folder / "points3D.ply")
        return Model(cameras, posed, np.arange(len(points)), points.astype(np.float64), colors)
    return Model(cameras, posed, np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3), np.uint8))


def _folders(root: Path, place: str) -> list[Path]:
    if not place.endswith("/*"):
        return [root / place]
    within = [path for path in (root / place[:-2]).glob("*") if not path.name.startswith(".")]
    return sorted(within, key=lambda path: (not path.name.isdecimal(), len(path.name), path.name))


def _suffix(folder: Path) -> str | None:
    """In which form a folder holds a model: the one with cameras and images, or else with cameras; None of none.

    Of two forms that do not list as many photos, the larger is taken, and a line says so.
    """
    having = [suffix for suffix in _SUFFIXES if (folder / f"cameras{suffix}").is_file()]
    whole = [suffix for suffix in having if (folder / f"images{suffix}").is_file()]
    if len(whole) < 2:
        return next(iter(whole or having), None)
    counts = {suffix: _count_images(folder, suffix) for suffix in whole}
    best, other = sorted(whole, key=lambda suffix: -counts[suffix])
    if counts[best] > counts[other]:
        line = f"{folder}/images{best} with {counts[best]} photos is read; images{other} has {counts[other]}"
        print_once(f"COLMAP: {line}")
    return best


def _largest(root: Path, models: Sequence[Path]) -> Path:
    counts = {model: _count_images(model, _suffix(model) or "") for model in models}
    best = max(models, key=lambda model: counts[model])
    others = ", ".join(f"{model.relative_to(root)} with {counts[model]}" for model in models if model != best)
    print_once(f"COLMAP: {best} with {counts[best]} photos is taken; there are also {others}")
    return best


def _count_images(model: Path, suffix: str) -> int:
    """What the file of images promises; 0 where it cannot be read, which raises when the model is read."""
    file = model / f"images{suffix}"
    try:
        return _counted(file, file.stat().st_mtime_ns)
    except (OSError, InputError):
        return 0


@lru_cache(maxsize=64)  # Text is read whole for it.
def _counted(file: Path, modified_ns: int) -> int:
    """The images in a file as it was written at a time, in nanoseconds."""
    return count_images(file)


def _posed_images(
    images: Sequence[PosedImage], cameras: dict[int, Lens], files: dict[str, Path]
) -> tuple[PosedImage, ...]:
    """The images of usable cameras and poses."""

    @cache
    def lens_fault(camera: int) -> str | None:
        try:
            check_lens(cameras[camera], f"{files['cameras']}: camera {camera}")
        except InputError as error:
            return str(error)

    def usable(image: PosedImage) -> PosedImage:
        if image.camera not in cameras:
            missing = f"{image.name} is of camera {image.camera}, which the model does not have"
            raise InputError(f"{files['images']}: {missing}")
        if fault := lens_fault(image.camera):
            raise InputError(fault)
        if not is_float32(np.array(image.pose)).all():
            raise InputError(f"{files['images']}: the pose of {image.name} is not finite")
        if np.linalg.norm(image.pose[:4]) < _SHORTEST_QUAT:
            raise InputError(f"{files['images']}: the quaternion of {image.name} is zero, which is no rotation")
        return image

    posed, faults = read_usable(images, lambda image: image.name, usable)
    leave_out("photos", faults, len(images))
    return tuple(posed)


def _cloud(file: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ids, places and colours of the finite points; colours of fractions are shares of 255."""
    points = read_colmap_points(file)
    finite = is_float32(points["xyz"]).all(axis=1)
    leave_out_rows(file, "points", finite)
    points = points[finite]
    points = points[np.argsort(points["id"], kind="stable")]
    colors = points["color"]
    if (colors % 1).any() and colors.max() <= 1:
        colors = 255 * colors
    return points["id"], points["xyz"], np.clip(np.rint(colors), 0, 255).astype(np.uint8)
