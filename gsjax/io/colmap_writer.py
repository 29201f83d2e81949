"""Frames and points as a COLMAP model."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gsjax.io.colmap import quiet
from gsjax.io.files import make_folder
from gsjax.io.packages import require
from gsjax.scene import Frame


def write_model(folder: Path, frames: Sequence[Frame], points: np.ndarray, colors: np.ndarray) -> None:
    """Writes a binary COLMAP model of PINHOLE cameras, one for all frames of the same size and intrinsics.

    Args:
        folder: Made where absent.
        frames: Their names become those of the images.
        points: `[P, 3]` world; without observations.
        colors: `[P, 3]` uint8.
    """
    pycolmap = require("pycolmap", "pip install pycolmap")
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
        pose = frame.viewmat.astype(np.float64)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:3, :3]), pose[:3, 3]))
    for point, color in zip(points.astype(np.float64), colors, strict=True):
        model.add_point3D(point, pycolmap.Track(), color)
    with quiet(pycolmap):
        model.write_binary(make_folder(folder))


def write_poses(folder: Path, viewmats: Mapping[str, np.ndarray]) -> None:
    """Gives images of a COLMAP model other poses; its points and their tracks stay.

    Args:
        folder: Of the model, replaced in place.
        viewmats: `[4, 4]` world to camera, by the images' names; images that are not named keep theirs.
    """
    pycolmap = require("pycolmap", "pip install pycolmap")
    with quiet(pycolmap):
        model = pycolmap.Reconstruction(folder)
        for image in model.images.values():
            if image.name in viewmats:
                pose = viewmats[image.name].astype(np.float64)
                moved = pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:3, :3]), pose[:3, 3])
                image.frame.set_cam_from_world(image.camera_id, moved)
        model.write_binary(folder)
