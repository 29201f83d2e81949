"""A COLMAP data set: its posed photos, points, and observations."""

import os
from functools import partial
from pathlib import Path

import numpy as np

from gsjax.io.colmap_files import PosedImage
from gsjax.io.colmap_model import Model, read_model
from gsjax.io.image_folders import found_files
from gsjax.io.lenses import camera_points
from gsjax.io.messages import print_once
from gsjax.io.photo_names import local_names, short_name
from gsjax.io.photos import Capture, Photo
from gsjax.io.random_points import COUNT, points_in_view
from gsjax.scene import Tracks
from gsjax.scene.similarity import is_float32


def read_capture(root: Path, model: Path) -> Capture:
    """Photos and points of a COLMAP model; a model without points gets random ones where its cameras look.

    Args:
        root: The data set; photos are in `images/` in it or next to the model, or in it directly.
        model: Folder of the model (`gsjax.io.colmap_model.find_model`).

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
