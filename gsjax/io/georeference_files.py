"""Where files say which place their coordinates are of (`gsjax.scene.georeference`).

A data set and a run hold `place.json`. A PLY says it in a comment, a GLB in the extras of its asset; next to any other
file `garden.spz` is `garden.spz.place.json`.
"""

import json
from pathlib import Path

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.scene.georeference import UNPLACED, Place, parse_place

FILE = "place.json"
EXTRAS = "place"  # the key in a GLB's `asset.extras`
_COMMENT = "comment place: "
_MOST_HEADER = 2**16  # bytes of a PLY in which its comments are looked for


def write_place(folder: Path, place: Place) -> None:
    """`place.json` of a data set or a run; none where nothing is known."""
    if place.is_known or place.up is not None:
        json_files.write(folder / FILE, place.record())
    else:
        (folder / FILE).unlink(missing_ok=True)


def read_place(folder: Path) -> Place:
    """What `place.json` in a data set or a run says."""
    file = folder / FILE
    return parse_place(json_files.read(file), file) if file.is_file() else UNPLACED


def place_comments(place: Place) -> list[str]:
    """The lines of a PLY's header that state a place: one, or none where nothing is known."""
    return [_COMMENT + json.dumps(json_files.plain(place.statement()))] if place.is_known else []


def state_beside(path: Path, place: Place) -> None:
    """State the place of a file that cannot hold it in a second file; remove one that is there of another file."""
    if place.is_known:
        json_files.write(_beside(path), place.statement())
    else:
        _beside(path).unlink(missing_ok=True)


def stated_place(path: Path) -> Place:
    """The place that a file of Gaussians or a mesh states, or a second file; unknown where none does."""
    suffix = path.suffix.lower()
    if suffix == ".ply":
        content = _in_ply(path)
    elif suffix == ".glb":
        content = _in_glb(path)
    else:
        content = json_files.read(_beside(path)) if _beside(path).is_file() else None
    return UNPLACED if content is None else parse_place(content, path)


def _beside(path: Path) -> Path:
    return Path(f"{path}.place.json")


def _in_ply(path: Path) -> object:
    with path.open("rb") as file:
        header = file.read(_MOST_HEADER).partition(b"end_header")[0].decode("utf-8", "replace")
    lines = [line.removeprefix(_COMMENT) for line in header.splitlines() if line.startswith(_COMMENT)]
    return json_files.parse(path, lines[-1]) if lines else None


def _in_glb(path: Path) -> object:
    with path.open("rb") as file:
        head = file.read(20)
        tree = file.read(int.from_bytes(head[12:16], "little"))
    try:
        return json.loads(tree)["asset"].get("extras", {}).get(EXTRAS)
    except (ValueError, KeyError, AttributeError, TypeError) as error:
        raise InputError(f"{path}: is no GLB ({type(error).__name__})") from error
