"""Files of the keyframes of a camera path."""

from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.scene.camera_path import Keyframes

FOVS = 1.0, 170.0  # degrees
_SHAPE = {"closed?": bool, "keyframes": [{"viewmat": [[float, 4], 4], "fov": float}]}
_RIGID = 1e-3  # Most that a product of a rotation with itself may differ from the identity.


def read_keyframes(path: str | Path) -> Keyframes:
    """Read the keyframes of a camera path from a JSON file, in the coordinates of the file.

    `{"closed": false, "keyframes": [{"viewmat": [[...], ...], "fov": 50.0}, ...]}`: 4x4 matrices by rows, world to
    camera, OpenCV axes, as `cameras.json` of a run has them; vertical angles of view in degrees.

    Raises:
        InputError: It cannot be read, has another shape, too few keyframes, or one that is no pose or no angle of view.
    """
    record = json_files.read(path, _SHAPE)
    closed, frames = record.get("closed", False), record["keyframes"]
    if len(frames) < 2 + closed:
        raise InputError(f"{path}: {len(frames)} keyframes; a path has {2 + closed} or more")
    viewmats = np.array([frame["viewmat"] for frame in frames], np.float64)
    for index, (viewmat, frame) in enumerate(zip(viewmats, frames, strict=True)):
        rotation = viewmat[:3, :3]
        is_rigid = np.abs(rotation).max() < 2 and np.abs(rotation @ rotation.T - np.eye(3)).max() < _RIGID
        if not (is_rigid and np.linalg.det(rotation) > 0 and (viewmat[3] == [0, 0, 0, 1]).all()):
            raise InputError(f"{path}: keyframes.{index}.viewmat is no rigid map from world to camera")
        if not FOVS[0] <= frame["fov"] <= FOVS[1]:
            raise InputError(
                f"{path}: keyframes.{index}.fov {frame['fov']:g} is not between {FOVS[0]:g} and {FOVS[1]:g}"
            )
    return Keyframes(viewmats, np.radians([frame["fov"] for frame in frames]), closed)
