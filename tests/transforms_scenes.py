"""Data sets of photos in a row with a transforms.json."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def write_transforms(root: Path, photos: dict[str, np.ndarray], file="transforms.json", **camera) -> Path:
    """A data set of photos, named as given, whose cameras stand 0.3 apart."""
    frames = []
    for index, (name, pixels) in enumerate(photos.items()):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(pixels).save(root / name, quality=95)
        pose = np.eye(4)
        pose[0, 3] = 0.3 * index
        frames.append({"file_path": name, "transform_matrix": (pose @ OPENGL).tolist()})
    (root / file).write_text(json.dumps({**camera, "frames": frames}))
    return root
