"""A folder of normal maps that a network made: the maps, and in `normals.json` what made them and which are done.

Maps are `.npz` with one float16 array `cam`, `[H, W, 3]` in camera axes (x right, y down, z forward), zero where there
is no normal: half precision turns a normal by at most 0.03 degrees. They show the frames of the data set, undistorted.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.files import atomic_path
from gsjax.io.temporary_files import sweep

MANIFEST = "normals.json"
PREFIX = "normals_"


def is_recorded(folder: str | Path) -> bool:
    """Whether a folder's maps were made by `gsjax normals`: they show undistorted frames, in our axes."""
    return (Path(folder) / MANIFEST).is_file()


def network_of(folder: str | Path) -> str | None:
    """The network that made a folder's maps, by its name; None where they came from elsewhere."""
    return _read(Path(folder))["made_by"]["network"] if is_recorded(folder) else None


def begin(folder: Path, made_by: Mapping[str, Any]) -> dict[str, Any]:
    """The manifest to continue: that of the folder where the same model made it, else a new one (not yet written).

    It holds `made_by`, what decides the maps (`network`, `sha256`, `record`); and `maps`, which has by a photo's name
    its `file` and what `add` was given `about` it.

    Raises:
        InputError: Another model's maps are there, or files of another origin.
    """
    if not is_recorded(folder):
        if any(path for path in folder.iterdir() if not path.name.startswith(".")):
            raise InputError(f"{folder}: holds files that gsjax normals did not make; choose another folder")
        return {"made_by": dict(made_by), "maps": {}}
    manifest = _read(folder)
    for key, now in made_by.items():
        before = manifest["made_by"].get(key)
        if before != now:
            raise InputError(
                f"{folder}: its maps were made with {_difference(key, before, now)}; choose another folder"
            )
    sweep(folder)
    return manifest


def add(folder: Path, manifest: dict[str, Any], name: str, file: Path, normals: np.ndarray, about: Any) -> None:
    """Writes the `[H, W, 3]` map of the photo `name` as `file` (within the folder), then the manifest that lists it."""
    if not is_recorded(folder):  # First, so that a run killed now is one that can go on.
        json_files.write(folder / MANIFEST, manifest)
    with atomic_path(folder / file) as temporary:
        np.savez_compressed(temporary, cam=normals.astype(np.float16))
    manifest["maps"][name] = {"file": str(file), **about}
    json_files.write(folder / MANIFEST, manifest)


def find(scene: str | Path, name: str) -> str:
    """The folder that `gsjax train --normals` means; `name` itself where it is one, or none is found.

    Args:
        scene: Folder of the data set.
        name: A folder; or the name of one in the data set, with or without `normals_` before it; or "auto", the only
            one there that `gsjax normals` made, and InputError where there is none or more than one.
    """
    scene = Path(scene)
    if os.path.isdir(name):
        return name
    if name == "auto":
        folders = sorted(path.parent for path in scene.glob(f"*/{MANIFEST}"))
        if len(folders) != 1:
            names = ", ".join(path.name for path in folders) or "none"
            raise InputError(f"normals: {scene} holds {names}; name one, or make one with gsjax normals")
        return str(folders[0].resolve())
    places = (scene / name, scene / f"{PREFIX}{name}")
    return next((str(place.resolve()) for place in places if os.path.isdir(place)), name)


def _read(folder: Path) -> dict[str, Any]:
    return json_files.read(folder / MANIFEST, {"made_by": {"network": str}, "maps": {str: object}})


def _difference(key: str, before: Any, now: Any) -> str:
    if isinstance(before, dict) and isinstance(now, dict):
        inner = next(k for k in {**before, **now} if before.get(k) != now.get(k))
        return _difference(f"{key}.{inner}", before.get(inner), now.get(inner))
    texts = [str(v)[:12] if key == "sha256" else json.dumps(v) for v in (before, now)]
    return f"{key} = {texts[0]}, not {texts[1]}"
