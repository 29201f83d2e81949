"""Ground truth in the folder of a data set, in the layout of rendered scenes."""

from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.io.arrays import headers, read_arrays
from gsjax.io.images import same_shape
from gsjax.io.normal_maps import unit_or_zero
from gsjax.scene import Frame, Truth
from gsjax.scene.georeference import UNPLACED, Place
from gsjax.scene.similarity import IDENTITY, Similarity


def load_truth(
    root: str | Path, frames: tuple[Frame, ...], similarity: Similarity = IDENTITY, place: Place = UNPLACED
) -> Truth | None:
    """What there is of `depth/STEM.npz`, `normals/STEM.npz`, `gt_points.npz` and `gt_mesh.ply`; None of nothing.

    `depth` holds `depth` [H, W] (camera z, scene units, 0 where nothing) and `label` [H, W] (0 sky, 255 ground, else
    object); `normals` holds `cam` [H, W, 3] (camera frame, 0 where nothing); `gt_points.npz` holds `points` and
    `normals` [P, 3] (world) and `label` [P] (0 object, 1 ground), of points that cameras saw; `gt_mesh.ply` is the
    whole surface, and counts only where there are such points. Of maps, headers are read now and pixels later,
    at the nearest pixel centre where a frame is smaller: averages of depths or normals would be on no surface. The
    mesh is named and not read.

    Args:
        root: Folder of the data set.
        frames: The frames whose maps are wanted.
        similarity: From the coordinates of the world to those of the frames.
        place: From the coordinates of the files to those of the world.

    Raises:
        InputError: A file is damaged, lacks an array, or does not fit its frame; also when a map is read.
    """
    root = Path(root)
    depths, normals, labels = {}, {}, {}
    for frame in frames:
        stem = str(PurePosixPath(frame.name).with_suffix(".npz"))
        if (file := root / "depth" / stem).is_file():
            _check(file, frame, "depth", "label")
            depths[frame.name] = partial(_read_depth, file, frame, similarity.scale * place.scale)
            labels[frame.name] = partial(_read, file, "label", frame, np.uint8)
        if (file := root / "normals" / stem).is_file():
            _check(file, frame, "cam")
            normals[frame.name] = partial(_read_normals, file, frame)
    surface = _surface(root, similarity, place)
    if not (depths or normals or surface):
        return None
    return Truth(depths, normals, labels, **surface)


def _surface(root: Path, similarity: Similarity, place: Place) -> dict[str, Any]:
    file, mesh = root / "gt_points.npz", root / "gt_mesh.ply"
    if not file.is_file():
        return {}
    arrays = read_arrays(file, "points", "normals", "label")
    return {
        "points": similarity.points_to_local(place.points_to_world(arrays["points"])),
        "point_normals": unit_or_zero(place.directions_to_world(arrays["normals"]).astype(np.float32)),
        "point_labels": arrays["label"].astype(np.uint8),
        "mesh": mesh if mesh.is_file() else None,
    }


def _check(file: Path, frame: Frame, *keys: str) -> None:
    """That the arrays are there and show what the frame shows."""
    for shape, _ in headers(file, *keys).values():
        height, width = (*shape, 0, 0)[:2]
        whole = frame.origin is None or (width, height) == frame.origin.undistorted
        if not (whole and same_shape((width, height), (frame.width, frame.height))):
            raise InputError(f"{file}: map is {width}x{height} but {frame.name} is {frame.width}x{frame.height}")


def _read_depth(file: Path, frame: Frame, scale: float) -> np.ndarray:
    return (scale * _read(file, "depth", frame, np.float64)).astype(np.float32)


def _read_normals(file: Path, frame: Frame) -> np.ndarray:
    return unit_or_zero(_read(file, "cam", frame, np.float32))


def _read(file: Path, key: str, frame: Frame, dtype: type) -> np.ndarray:
    """An array at the frame's size, each pixel that of the nearest centre."""
    array = read_arrays(file, key)[key]
    height, width = array.shape[:2]
    rows = ((np.arange(frame.height) + 0.5) * height / frame.height).astype(int)
    columns = ((np.arange(frame.width) + 0.5) * width / frame.width).astype(int)
    return array[rows[:, None], columns].astype(dtype)
