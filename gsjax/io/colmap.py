"""A COLMAP data set: where its model is, and its posed photos, points and observations.

Its files are read by `gsjax.io.colmap_files` because pycolmap 4.2 reads past the end of a truncated file, drops every
second image of an `images.txt` without keypoint lines, ends names at their first space, and shears the scene by a
quaternion that is not of unit length. `rigs` and `frames` are not read: they say nothing that `images` does not.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io import colmap_files
from gsjax.io.bad_items import leave_out, leave_out_rows, read_usable
from gsjax.io.colmap_files import PosedImage
from gsjax.io.image_folders import found_files
from gsjax.io.lenses import Lens, camera_points, check_lens
from gsjax.io.messages import print_once
from gsjax.io.photo_names import local_names, short_name
from gsjax.io.photos import Capture, Photo
from gsjax.io.ply import read_points
from gsjax.io.random_points import COUNT, points_in_view
from gsjax.scene import Tracks
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
    if len(models) < 2:
        return next(iter(models), None)
    counts = {model: _count_images(model, _suffix(model) or "") for model in models}
    best = max(models, key=lambda model: counts[model])
    others = ", ".join(f"{model.relative_to(root)} with {counts[model]}" for model in models if model != best)
    print_once(f"COLMAP: {best} with {counts[best]} photos is taken; there are also {others}")
    return best


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
    cameras = colmap_files.read_cameras(files["cameras"])
    if not cameras:
        raise InputError(f"{files['cameras']}: no camera in it")
    images = sorted(colmap_files.read_images(files["images"]), key=lambda image: image.name)
    posed = _posed_images(images, cameras, files)
    if files["points3D"].is_file():
        return Model(cameras, posed, *_cloud(files["points3D"]))
    if (folder / "points3D.ply").is_file():
        points, colors = read_points(folder / "points3D.ply")
        return Model(cameras, posed, np.arange(len(points)), points.astype(np.float64), colors)
    return Model(cameras, posed, np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3), np.uint8))


def read_capture(root: Path, model: Path) -> Capture:
    """Photos and points of a COLMAP model; a model without points gets random ones where its cameras look.

    Args:
        root: The data set; photos are in `images/` in it or next to the model, or in it directly.
        model: Folder of the model (`find_model`).

    Raises:
        InputError: A file is missing, truncated or contradicts another; a camera model is unknown.
    """
    read = read_model(model)
    places = _image_places(root, model)
    listed = [image.name for image in read.images]
    names = local_names(listed, lambda name: any(os.path.isfile(place / name) for place in places), model)
    names = [name if name == before else short_name(name) for name, before in zip(names, listed, strict=True)]
    folder = max(places, key=lambda place: sum(map(os.path.isfile, found_files([place / name for name in names]))))
    photos = tuple(
        Photo(name, folder / name, image.viewmat, read.cameras[image.camera])
        for name, image in zip(names, read.images, strict=True)
    )
    if not len(read.points) and photos:
        print_once(f"points: {model} has none; training starts from {COUNT:,} random ones where the cameras look")
        return Capture("colmap", photos, *points_in_view(np.stack([photo.viewmat for photo in photos])))
    return Capture("colmap", photos, read.points, read.point_colors, partial(read_tracks, model))


def read_tracks(model: Path) -> Tracks:
    """The observations of a COLMAP model, photos sorted by name, points in the order of `read_capture`.

    Keypoints without a point in the model are left out, and those for which the lens has no ray.
    """
    read = read_model(model)
    parts = [_observations(read, image) for image in read.images]
    points, rays = ([part[side] for part in parts] for side in (0, 1))
    return Tracks(
        names=tuple(image.name for image in read.images),
        photo=np.repeat(np.arange(len(parts), dtype=np.int32), [len(part) for part in points]),
        point=np.concatenate([np.empty(0, np.int32), *points]),
        rays=np.concatenate([np.empty((0, 2), np.float32), *rays]),
    )


def _observations(model: Model, image: PosedImage) -> tuple[np.ndarray, np.ndarray]:
    """`[O]` rows of the points that a photo saw, and `[O, 2]` rays to them."""
    point_ids, pixels = image.keypoints["point"], np.ascontiguousarray(image.keypoints["xy"])
    has_point = np.isin(point_ids, model.point_ids) & is_float32(pixels).all(axis=1)
    if not has_point.any():
        return np.empty(0, np.int32), np.empty((0, 2), np.float32)
    rows = np.searchsorted(model.point_ids, point_ids[has_point])
    rays = camera_points(model.cameras[image.camera], pixels[has_point])
    usable = is_float32(rays).all(axis=1)
    return rows[usable].astype(np.int32), rays[usable].astype(np.float32)


def _image_places(root: Path, model: Path) -> list[Path]:
    """Where photos may be, the usual place first."""
    above = Path(os.path.abspath(model)).parents[:2]
    return [root / "images", *(folder / "images" for folder in (model, *above)), root]


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


def _count_images(model: Path, suffix: str) -> int:
    """What the file of images promises; 0 where it cannot be read, which raises when the model is read."""
    try:
        return colmap_files.count_images(model / f"images{suffix}")
    except (OSError, InputError):
        return 0


def _posed_images(
    images: Sequence[PosedImage], cameras: dict[int, Lens], files: dict[str, Path]
) -> tuple[PosedImage, ...]:
    """The images of usable cameras and poses."""

    def usable(image: PosedImage) -> PosedImage:
        if image.camera not in cameras:
            missing = f"{image.name} is of camera {image.camera}, which the model does not have"
            raise InputError(f"{files['images']}: {missing}")
        check_lens(cameras[image.camera], f"{files['cameras']}: camera {image.camera}")
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
    points = colmap_files.read_points(file)
    finite = is_float32(points["xyz"]).all(axis=1)
    leave_out_rows(file, "points", finite)
    points = points[finite]
    points = points[np.argsort(points["id"], kind="stable")]
    colors = points["color"]
    if (colors % 1).any() and colors.max() <= 1:
        colors = 255 * colors
    return points["id"], points["xyz"], np.clip(np.rint(colors), 0, 255).astype(np.uint8)
