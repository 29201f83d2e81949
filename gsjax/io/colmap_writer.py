"""Frames and points as a COLMAP model."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gsjax.errors import InputError
from gsjax.io.colmap import read_model
from gsjax.io.files import flush, make_folder
from gsjax.io.packages import require
from gsjax.scene import Frame
from gsjax.scene.similarity import IDENTITY, Similarity

if TYPE_CHECKING:
    import pycolmap

    from gsjax.scene.cameras import Camera


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
        points: `[P, 3]`, as the frames have them; without observations.
        colors: `[P, 3]` uint8.
        similarity: To the coordinates of frames and points from those of the model.
    """
    pycolmap = require("pycolmap")
    model = pycolmap.Reconstruction()
    cameras: dict[tuple, int] = {}
    for number, frame in enumerate(frames, 1):
        intrinsics = (frame.width, frame.height, *frame.K.ravel())
        if intrinsics not in cameras:
            cameras[intrinsics] = len(cameras) + 1
            model.add_camera_with_trivial_rig(pinhole_camera(len(cameras), frame))
        image = pycolmap.Image(name=frame.name, camera_id=cameras[intrinsics], image_id=number)
        pose = similarity.viewmat_to_world(frame.viewmat)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:3, :3]), pose[:3, 3]))
    for point, color in zip(similarity.points_to_world(points), colors, strict=True):
        model.add_point3D(point, pycolmap.Track(), color)
    write_whole(model, folder)


def pinhole_camera(number: int, view: "Frame | Camera") -> "pycolmap.Camera":
    """The camera of a view, with this number as its id."""
    pycolmap = require("pycolmap")
    K = np.asarray(view.K, np.float64)
    params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    return pycolmap.Camera(camera_id=number, model="PINHOLE", width=view.width, height=view.height, params=params)


def write_whole(model: "pycolmap.Reconstruction", folder: Path) -> None:
    """Writes a model in binary and reads it again: pycolmap 4.2 does not report a full disk, which is an InputError."""
    log = require("pycolmap").logging
    level, log.minloglevel = log.minloglevel, 4  # What matters of its log comes as an exception.
    make_folder(folder)
    try:
        model.write_binary(folder)
        for file in folder.glob("*.bin"):
            flush(file)
        stored_model = read_model(folder)
        if (len(stored_model.images), len(stored_model.points)) != (model.num_reg_images(), model.num_points3D()):
            raise ValueError("the model on the disk has fewer images or points")
    except (OSError, ValueError, RuntimeError) as error:  # InputError is a ValueError: what was written is cut.
        fault = f"the model did not come whole onto the disk, which has {shutil.disk_usage(folder).free} bytes left"
        raise InputError(f"cannot write {folder}: {fault}") from error
    finally:
        log.minloglevel = level
