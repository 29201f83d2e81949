"""`transforms.json` as instant-ngp, nerfstudio and ScanNet++ write it, and the NeRF-synthetic layout."""

import json
import os
import posixpath
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.bad_items import leave_out, read_usable
from gsjax.io.files import read_bytes
from gsjax.io.messages import print_once
from gsjax.io.photo_names import local_names, short_name
from gsjax.io.photos import Capture, Photo
from gsjax.io.ply import read_points
from gsjax.io.random_points import points_in_synthetic_cube, points_in_view
from gsjax.io.transforms_cameras import depth_of, lens_of, viewmat_of

FILES = ("transforms.json", "transforms_train.json")  # Of instant-ngp and nerfstudio; of the NeRF-synthetic layout.
_TESTS = ("transforms_test.json", "transforms_val.json")  # The first that is there holds out its photos.
_SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".PNG", ".JPG")  # The layout may leave it out.
_TRAIN, _SCORE = "train_filenames", ("test_filenames", "val_filenames")  # Lists of nerfstudio.
_TEST_FRAMES = "test_frames"  # ScanNet++'s list of frames of their own; it marks bad ones by `is_bad`.
_SPLITS_OF_SCORES = {"test", "val", "validation", "eval"}  # What others say of each frame as its `split`.


def read_transforms(root: Path) -> Capture:
    """Photos and points of a folder with `transforms.json`.

    Points are those that `ply_file_path` names, or else random ones (`gsjax.io.random_points.points_in_view`). The
    split is the one that the file states, if it does, or that a file for testing next to it does.
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

    Points are random in [-1.3, 1.3]^3, as in 3DGS, or where the cameras look if they are not around that.
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
    frames = _used_frames(file, meta)
    names = local_names(
        [entry["file_path"] for entry, _ in frames], lambda name: os.path.isfile(_existing(file.parent, name)), file
    )
    paths = [_existing(file.parent, name) for name in names]

    def photo(listed: tuple[str, Path, tuple[dict[str, Any], bool]]) -> Photo:
        name, path, (entry, is_test) = listed
        # The photo itself may be in another folder, where `gsjax.io.image_folders` looks for it.
        return Photo(
            name=_name(file.parent, name, path),
            path=path,
            viewmat=viewmat_of(file, entry),
            lens=lens_of(file, entry, path),
            mask_path=_file_in(file, entry, "mask_path"),
            held_out=held_out or is_test,
            depth=depth_of(entry, _file_in(file, entry, "depth_file_path")),
        )

    photos, faults = read_usable(zip(names, paths, frames, strict=True), lambda listed: listed[0], photo)
    leave_out("frames", faults, len(frames), needed=0 if held_out else None)
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


def _used_frames(file: Path, meta: dict[str, Any]) -> list[tuple[dict[str, Any], bool]]:
    """The entries of the frames that are used, each with what the file says for all, and whether it is held out.

    Frames that a list for scoring names, or that say so themselves, are held out, whatever another list says. Where the
    file lists those to train on, the rest is held out, or left out if there is a list for scoring too. Bad frames are
    left out. A line on stderr counts those that are left out.

    Raises:
        InputError: A frame has no `file_path`, or a list names a photo that is in no frame.
    """
    shared = {key: value for key, value in meta.items() if key not in ("frames", _TEST_FRAMES)}
    tests = meta.get(_TEST_FRAMES) or []
    are_frames = isinstance(tests, list) and all(isinstance(frame, dict) for frame in tests)
    own = [{**frame, "split": "test"} for frame in tests] if are_frames else []
    listed = [*meta["frames"], *own]
    frames, faults = read_usable(enumerate(listed), lambda each: f"frame {each[0]}", partial(_named, file))
    leave_out("frames", faults, len(listed))
    names = [_normal(frame["file_path"]) for frame in frames]
    trained = _listed(file, meta, _TRAIN, names)
    scored = set().union(*(_listed(file, meta, key, names) for key in (*_SCORE, *([] if own else [_TEST_FRAMES]))))
    are_scored = [
        name in scored or str(frame.get("split")).lower() in _SPLITS_OF_SCORES
        for name, frame in zip(names, frames, strict=True)
    ]

    def is_held_out(frame: dict[str, Any], name: str, is_scored: bool) -> bool | None:
        """None of a frame that is left out."""
        if _is_bad(frame):
            return None
        if trained and name not in trained and not is_scored:
            return None if any(are_scored) else True
        return is_scored

    held_out = list(map(is_held_out, frames, names, are_scored))
    if (left_out := held_out.count(None)) == len(frames):
        raise InputError(f"{file}: leaves all of its frames out")
    if left_out:
        bad = sum(map(_is_bad, frames))
        print_once(f"{file}: {bad} of its frames are left out as bad, {left_out - bad} as being in no list of it")
    return [({**shared, **frame}, use) for frame, use in zip(frames, held_out, strict=True) if use is not None]


def _named(file: Path, numbered: tuple[int, Any]) -> dict[str, Any]:
    number, frame = numbered
    if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
        raise InputError(f'{file}: frame {number} has no "file_path"')
    return frame


def _is_bad(frame: dict[str, Any]) -> bool:
    """Whether a frame says so, as true, 1 or a word."""
    return str(frame.get("is_bad")).lower() in ("true", "1", "yes")


def _listed(file: Path, meta: dict[str, Any], key: str, names: Sequence[str]) -> set[str]:
    """The photos of a list, in the form of `names`."""
    value = meta.get(key)
    if value is None:
        return set()
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise InputError(f"{file}: {key} is no list of names")
    listed_names = {_normal(name): name for name in value}
    unknown = [listed_names[name] for name in sorted(listed_names.keys() - set(names))]
    if unknown:
        raise InputError(f"{file}: {key} lists {unknown[0]}, which is the file_path of no frame")
    return set(listed_names)


def _normal(name: str) -> str:
    return posixpath.normpath(name.replace("\\", "/"))
