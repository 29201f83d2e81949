from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest


@pytest.fixture
def colmap_scene(tmp_path: Path) -> Callable[..., Path]:
    """Writes a small COLMAP data set: cameras in a row looking along +z at points in front, images of noise."""

    def make(
        count: int = 10,
        model: str = "PINHOLE",
        params: tuple[float, ...] = (30.0, 31.0, 21.0, 14.5),
        size: tuple[int, int] = (40, 30),
        points: int = 5,
        text: bool = False,
    ) -> Path:
        root = tmp_path / "scene"
        (root / "images").mkdir(parents=True)
        (root / "sparse/0").mkdir(parents=True)
        rng = np.random.default_rng(0)
        width, height = size
        model_ = pycolmap.Reconstruction()
        model_.add_camera_with_trivial_rig(
            pycolmap.Camera(camera_id=1, model=model, width=width, height=height, params=list(params))
        )
        for i in range(count):
            name = f"{i:03d}.png"
            image = pycolmap.Image(name=name, camera_id=1, image_id=i + 1)
            pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([0.1 * i, 0.0, 0.0]))
            model_.add_image_with_trivial_frame(image, pose)
            noise = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
            cv2.imwrite(str(root / "images" / name), noise)
        for i in range(points):
            model_.add_point3D(np.array([i, 1.0, 5.0]), pycolmap.Track(), np.array([i, 2, 3], np.uint8))
        (model_.write_text if text else model_.write_binary)(root / "sparse/0")
        return root

    return make
