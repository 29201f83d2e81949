"""Frames and points as a COLMAP model."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gsjax.errors import InputError
from gsjax.io.colmap import quiet
from gsjax.io.colmap_model import read_model
from gsjax.io.files import flush, make_folder
from gsjax.io.packages import require
from gsjax.scene import Frame
from gsjax.scene.similarity import IDENTITY, Similarity

if TYPE_CHECKING:
    import pycolmap


def write_model(
    folder: Path,
    frames: Sequence[Frame],
    points: np.ndarray,
    colors: np.ndarray,
    similarity: Similarity = IDENTITY,
) -> None:
    """Writes a binary COLMAP model of PINHOLE cameras, one for all frames of the same size and intrinsics.

    Args:
        folder: Made where absent.
        frames: Their names become those of the images.
        points: `[P, 3]` world; without observations.
        colors: `[P, 3]` uint8.
        similarity: To the coordinates of frames and points from those of the model.
    """
    pycolmap = require("pycolmap")
    model = pycolmap.Reconstruction()
    cameras: dict[tuple, int] = {}
    for number, frame in enumerate(frames, 1):
        K = frame.K.astype(np.float64)
        size, params = (frame.width, frame.height), (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        if (size, params) not in cameras:
            cameras[size, params] = len(cameras) + 1
            model.add_camera_with_trivial_rig(
                pycolmap.Camera(
                    camera_id=len(cameras), model="PINHOLE", width=size[0], height=size[1], params=list(params)
                )
            )
        image = pycolmap.Image(name=frame.name, camera_id=cameras[size, params], image_id=number)
        pose = similarity.viewmat_to_world(frame.viewmat)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:3, :3]), pose[:3, 3]))
    for point, color in zip(similarity.points_to_world(points), colors, strict=True):
        model.add_point3D(point, pycolmap.Track(), color)
    write_whole(model, folder)


def write_whole(model: "pycolmap.Reconstruction", folder: Path) -> None:
    """Writes a `pycolmap.Reconstruction` in binary, and sees that all of it has come onto the disk.

    pycolmap 4.2 does not report a full disk.

    Args:
        model: The reconstruction to write.
        folder: Made where absent.

    Raises:
        InputError: It cannot be written.
    """
    pycolmap = require("pycolmap")
    make_folder(folder)
    try:
        with quiet(pycolmap):
            model.write_binary(folder)
        for file in folder.glob("*.bin"):
            flush(file)
        stored_model = read_model(folder)
    except (OSError, ValueError, RuntimeError) as error:  # InputError is a ValueError: what was written is cut.
        raise _unwritten(folder) from error
    if (len(stored_model.images), len(stored_model.points)) != (model.num_reg_images(), model.num_points3D()):
        raise _unwritten(folder)


def _unwritten(folder: Path) -> InputError:
    left = shutil.disk_usage(folder).free
    return InputError(f"cannot write {folder}: the model did not come whole onto the disk, which has {left} bytes left")
