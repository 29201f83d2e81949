"""Run folders written by hand: nothing is trained for them."""

from pathlib import Path

import numpy as np

from gsjax.gaussians import Gaussians
from gsjax.io import json_files
from gsjax.io.ply import write_gaussians
from gsjax.runs.result import write_views
from gsjax.scene import Pixels, frame_of


def write_run(folder: Path, gaussians: Gaussians, cameras, *, prefix: str = "") -> Path:
    """A run over white without checkpoints; its photos are black and named by `prefix` and their index."""
    frames = [
        frame_of(
            f"{prefix}{index}.jpg",
            np.asarray(camera.viewmat),
            np.asarray(camera.K),
            Pixels(np.zeros((camera.height, camera.width, 3), np.uint8)),
        )
        for index, camera in enumerate(cameras)
    ]
    json_files.write(folder / "config.json", {"model": {"background": "white"}})
    write_gaussians(folder / "gaussians.ply", gaussians)
    write_views(folder, tuple(frames))
    return folder
