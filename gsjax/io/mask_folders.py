"""Masks of photos, in a folder of their own beside them."""

import os
from collections import Counter
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from gsjax.io.photo_names import path_inside


def masks_in(folder: Path, names: Iterable[str]) -> dict[str, Path]:
    """The masks that a folder holds, by the photos' names.

    A mask has the photo's name, that name with `.png` after it, or its stem with `.png`; within the same subfolders, or
    in the folder itself where no other photo's file is called the same.
    """
    within = {name: path_inside(name) for name in names}
    alike = Counter(path.name for path in within.values())
    places = {
        name: [path] if alike[path.name] > 1 else [path, PurePosixPath(path.name)] for name, path in within.items()
    }
    found = {name: next((m for place in where if (m := _mask(folder / place))), None) for name, where in places.items()}
    return {name: mask for name, mask in found.items() if mask is not None}


def _mask(same: Path) -> Path | None:
    candidates = (same, Path(f"{same}.png"), Path(f"{os.path.splitext(same)[0]}.png"))
    return next((path for path in candidates if os.path.isfile(path)), None)
