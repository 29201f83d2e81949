"""Ground truth beside the images of a data set, in the layout of rendered scenes."""

import zipfile
from lzma import LZMAError
from pathlib import Path, PurePosixPath

import numpy as np

from gsjax.errors import InputError
from gsjax.io.photos import scaled_size
from gsjax.scene import Frame, Truth


def load_truth(root: str | Path, frames: tuple[Frame, ...], *, downscale: float = 1.0) -> Truth | None:
    """Loads what there is of `depth/STEM.npz`, `normals/STEM.npz` and `gt_points.npz`; None where there is nothing.

    `depth` holds `depth` [H, W] (camera z, scene units, 0 where nothing) and `label` [H, W] (0 sky, 255 ground, else
    object); `normals` holds `cam` [H, W, 3] (camera frame, 0 where nothing); `gt_points.npz` holds `points` and
    `normals` [P, 3] (world) and `label` [P] (0 object, 1 ground). Maps are read at the nearest pixel centre where the
    frames are downscaled: averages of depths or normals would lie on no surface.

    Args:
        root: Folder of the data set.
        frames: The frames whose maps are wanted.
        downscale: The factor by which the frames were reduced.

    Raises:
        InputError: A file is damaged, lacks an array, or does not fit its frame; names the file.
    """
    root = Path(root)
    depths, normals, labels = {}, {}, {}
    for frame in frames:
        stem = str(PurePosixPath(frame.name).with_suffix(".npz"))
        if (file := root / "depth" / stem).is_file():
            arrays = read_arrays(file, "depth", "label")
            depths[frame.name] = _nearest(file, arrays["depth"], frame, downscale).astype(np.float32)
            labels[frame.name] = _nearest(file, arrays["label"], frame, downscale).astype(np.uint8)
        if (file := root / "normals" / stem).is_file():
            cam = _nearest(file, read_arrays(file, "cam")["cam"], frame, downscale).astype(np.float32)
            normals[frame.name] = _unit_or_zero(cam)
    surface = _surface(root / "gt_points.npz")
    if not (depths or normals or surface):
        return None
    return Truth(depths, normals, labels, **surface)


def read_arrays(file: Path, *keys: str) -> dict[str, np.ndarray]:
    """The named arrays of an `.npz` (all of them where none is named).

    Raises:
        InputError: The file is damaged or lacks one.
    """
    try:
        with file.open("rb") as handle, np.load(handle) as archive:
            missing = [key for key in keys if key not in archive]
            if missing:
                raise InputError(f"{file}: lacks {', '.join(missing)}; it holds {', '.join(archive)}")
            return {key: archive[key] for key in keys or archive}
    except InputError:
        raise
    except (OSError, ValueError, EOFError, TypeError, AttributeError, zipfile.BadZipFile, LZMAError) as error:
        raise InputError(f"{file}: cannot be read ({error})") from error


def _surface(file: Path) -> dict[str, np.ndarray]:
    if not file.is_file():
        return {}
    arrays = read_arrays(file, "points", "normals", "label")
    return {
        "points": arrays["points"].astype(np.float32),
        "point_normals": _unit_or_zero(arrays["normals"].astype(np.float32)),
        "point_labels": arrays["label"].astype(np.uint8),
    }


def _nearest(file: Path, array: np.ndarray, frame: Frame, downscale: float) -> np.ndarray:
    height, width = array.shape[:2]
    if scaled_size(width, height, downscale) != (frame.width, frame.height):
        raise InputError(f"{file}: map is {width}x{height} but {frame.name} is {frame.width}x{frame.height}")
    rows = ((np.arange(frame.height) + 0.5) * height / frame.height).astype(int)
    columns = ((np.arange(frame.width) + 0.5) * width / frame.width).astype(int)
    return array[rows[:, None], columns]


def _unit_or_zero(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors, float32; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return (vectors / np.where(length > 0, length, 1)).astype(np.float32)
