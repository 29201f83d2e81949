"""Where the files of a data set's photos and masks are: in the folder that is named, or in those that there are."""

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from gsjax.errors import InputError
from gsjax.io.images import SUFFIXES
from gsjax.io.messages import print_once
from gsjax.io.photo_names import path_inside, spellings
from gsjax.io.photos import Photo

MASK_ENDS = (".mask.png", "_mask.png")  # behind a photo's name or stem, in a folder of masks or beside the photo
REDUCED = ("images_2", "images_4", "images_8")  # Copies of reduced size, as benchmarks bring them, largest first.


def locate_photos(root: Path, photos: Sequence[Photo], images: str | None) -> list[Photo]:
    """The photos with the paths of the files that there are; what is not found keeps the path where it should be.

    Args:
        root: Folder of the data set.
        photos: As the data set lists them.
        images: Folder that holds them by their names, absolute or in `root`; InputError where it does not exist. None:
            where the data set says, or, where none of them is there, the largest of `REDUCED` that holds the most; one
            line on stderr says so.
    """
    if images is not None:
        if not os.path.isdir(root / images):
            raise InputError(f"{root / images}: no such folder of images")
        return _in_folder(photos, root / images)
    originals = _with_files(photos, [photo.path for photo in photos])
    if _count(originals):
        return originals
    reduced = [_in_folder(photos, root / folder) for folder in REDUCED]
    best = max(range(len(REDUCED)), key=lambda index: _count(reduced[index]))
    if not _count(reduced[best]):
        return originals
    print_once(f"images: none where {root} says; {root / REDUCED[best]} is taken")
    return reduced[best]


def found_files(paths: Sequence[Path]) -> list[Path]:
    """Each path itself where it is a file, else another spelling of it, else the image in its folder of the same stem.

    Stems are compared whatever their suffix and case. One that two of the paths share, or two images, is ambiguous:
    the path stays as it is.
    """
    stem_counts = Counter(_stem(path) for path in paths)

    @cache
    def images_in(folder: Path) -> dict[Path, list[Path]]:
        listed = folder.glob("*") if os.path.isdir(folder) else ()
        images = [p for p in listed if p.suffix.lower() in SUFFIXES and os.path.isfile(p)]
        by_stem: dict[Path, list[Path]] = {}
        for image in images:
            by_stem.setdefault(_stem(image), []).append(image)
        return by_stem

    def existing(path: Path) -> Path:
        if os.path.isfile(path):
            return path
        spelled = next((other for other in spellings(path) if os.path.isfile(other)), None)
        if spelled is not None:
            return spelled
        same = images_in(path.parent).get(_stem(path), [])
        return same[0] if len(same) == 1 and stem_counts[_stem(path)] == 1 else path

    return [existing(path) for path in paths]


def _in_folder(photos: Sequence[Photo], folder: Path) -> list[Photo]:
    names = [Path(photo.name) for photo in photos]  # Absolute where a data set lists photos outside its folder.
    return _with_files(
        photos, [folder / (name.name if name.is_absolute() else path_inside(str(name))) for name in names]
    )


def _with_files(photos: Sequence[Photo], paths: Sequence[Path]) -> list[Photo]:
    return [replace(photo, path=path) for photo, path in zip(photos, found_files(paths), strict=True)]


def _count(photos: Sequence[Photo]) -> int:
    return sum(os.path.isfile(photo.path) for photo in photos)


def _stem(path: Path) -> Path:
    return path.parent / path.stem.casefold()


def masks_in(folder: Path, names: Iterable[str]) -> dict[str, Path]:
    """The masks that a folder holds, by the photos' names (`files_of_photos`).

    A mask has the photo's name, that name or its stem with `.png` after it, or with `.mask.png` (RealityScan) or
    `_mask.png` (Metashape).
    """
    return files_of_photos(folder, names, ("", ".png", *MASK_ENDS))


def files_of_photos(folder: Path, names: Iterable[str], ends: Sequence[str]) -> dict[str, Path]:
    """The files that belong to photos, by the photos' names: the first that there is of each.

    A file has the photo's name with one of the `ends` after it, or in place of its suffix; within the same subfolders,
    or in the folder itself where no other photo's file is called the same.
    """
    inside = {name: path_inside(name) for name in names}
    counts = Counter(path.name for path in inside.values()), Counter(path.stem for path in inside.values())
    files: dict[str, Path] = {}
    for name, path in inside.items():
        places = [str(path), os.path.splitext(path)[0]]
        places += [each for each, count in zip((path.name, path.stem), counts, strict=True) if count[each] == 1]
        candidates = (folder / f"{place}{end}" for place in places for end in ends)
        if (file := next((file for file in candidates if os.path.isfile(file)), None)) is not None:
            files[name] = file
    return files
