"""`transforms.json` as instant-ngp, nerfstudio and ScanNet++ write it, and the NeRF-synthetic layout."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.bad_items import leave_out, read_usable
from gsjax.io.files import read_bytes
from gsjax.io.photo_names import local_names, short_name
from gsjax.io.photos import Capture, Photo
from gsjax.io.ply import read_points
from gsjax.io.random_points import points_in_synthetic_cube, points_in_view
from gsjax.io.transforms_cameras import depth_of, lens_of, viewmat_of
from gsjax.io.transforms_splits import HELD_OUT, LEFT_OUT, frames_and_uses

FILES = ("transforms.json", "transforms_train.json")  # Of instant-ngp and nerfstudio; of the NeRF-synthetic layout.
_TESTS = ("transforms_test.json", "transforms_val.json")  # The first that is there holds out its photos.
_SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".PNG", ".JPG")  # The layout may leave it out.


def read_transforms(root: Path) -> Capture:
    """Photos and points of a folder with `transforms.json`.

    Points are those that `ply_file_path` names, or else random ones (`gsjax.io.random_points.points_in_view`). The
    split is the one that the file states, if it does (`gsjax.io.transforms_splits`), or that a file for testing next
    to it does.
    """
    file = root / FILES[0]
    meta = _read_json(file)
    photos = _with_tests(root, _photos(file, meta))
    cloud = _file_in(file, meta, "ply_file_path")
    if cloud is None:
        return Capture("transforms", photos, *points_in_view(np.stack([p.viewmat for p in photos])))
    if not os.path.isfile(cloud):
        raise InputError(f"{cloud}: cannot be read (no such file)")
    points, colors = read_points(cloud)
    return Capture("transforms", photos, points.astype(np.float64), colors)


def read_synthetic(root: Path) -> Capture:
    """Photos of the NeRF-synthetic layout; those of `transforms_test.json`, or else of `_val`, are held out.

    Points are random in [-1.3, 1.3]^3, as in 3DGS, or where the cameras look if they do not stand around that.
    """
    train = root / FILES[1]
    photos = _with_tests(root, _photos(train, _read_json(train)))
    viewmats = np.stack([photo.viewmat for photo in photos])
    return Capture("nerf-synthetic", photos, *points_in_synthetic_cube(viewmats))


def _with_tests(root: Path, photos: tuple[Photo, ...]) -> tuple[Photo, ...]:
    """The photos, and those that a file for testing lists, which are held out."""
    file = next((root / name for name in _TESTS if (root / name).is_file()), None)
    tests = () if file is None else _photos(file, _read_json(file), held_out=True)
    names = {photo.name for photo in tests}
    return (*(photo for photo in photos if photo.name not in names), *tests)


def _read_json(file: Path) -> dict[str, Any]:
    """With or without a byte order mark; text that is no UTF is Latin-1."""
    data = read_bytes(file)
    try:
        text = data.decode(json.detect_encoding(data))
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    meta = json_files.parse(file, text)
    if not isinstance(meta, dict) or not isinstance(meta.get("frames"), list) or not meta["frames"]:
        raise InputError(f'{file}: has no list "frames"')
    return meta


def _photos(file: Path, meta: dict[str, Any], held_out: bool = False) -> tuple[Photo, ...]:
    entries, uses = frames_and_uses(file, meta)
    entries = [entry for entry, use in zip(entries, uses, strict=True) if use != LEFT_OUT]
    uses = [use for use in uses if use != LEFT_OUT]
    if not entries:
        raise InputError(f"{file}: leaves all of its frames out")
    names = local_names(
        [entry["file_path"] for entry in entries], lambda name: os.path.isfile(_existing(file.parent, name)), file
    )
    paths = [_existing(file.parent, name) for name in names]

    def photo(frame: tuple[str, Path, dict[str, Any], str]) -> Photo:
        name, path, entry, use = frame
        # The photo itself may lie in another folder, where `gsjax.io.image_folders` looks for it.
        return Photo(
            name=_name(file.parent, name, path),
            path=path,
            viewmat=viewmat_of(file, entry),
            lens=lens_of(file, entry, path),
            mask_path=_file_in(file, entry, "mask_path"),
            held_out=held_out or use == HELD_OUT,
            depth=depth_of(entry, _file_in(file, entry, "depth_file_path")),
        )

    photos, faults = read_usable(zip(names, paths, entries, uses, strict=True), lambda frame: frame[0], photo)
    leave_out("frames", faults, len(entries), needed=0 if held_out else None)
    return tuple(photos)


def _existing(root: Path, name: str) -> Path:
    """The photo of a name: in the folder of the file or in `images/` there, with or without its suffix."""
    candidates = [folder / f"{name}{suffix}" for folder in (root, root / "images") for suffix in _SUFFIXES]
    return next((c for c in candidates if os.path.isfile(c)), candidates[0])


def _name(root: Path, name: str, path: Path) -> str:
    """The photo's name as listed, links in its path left as they are, with the suffix of its file."""
    name += path.name.removeprefix(Path(name).name)
    for folder in (os.path.abspath(root), os.path.realpath(root)):
        name = name.removeprefix(f"{folder}/")
    return short_name(name)


def _file_in(file: Path, entry: dict[str, Any], key: str) -> Path | None:
    """The file that an entry names, here; None where it names none."""
    listed_as = entry.get(key)
    if listed_as is None or listed_as == "":
        return None
    if not isinstance(listed_as, str):
        raise InputError(f"{file}: {key} is no text")
    (name,) = local_names([listed_as], lambda name: os.path.isfile(file.parent / name), file)
    return file.parent / name
