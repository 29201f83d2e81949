"""What a data set is once it is loaded: plain records of numpy arrays, whatever the files looked like."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Frame:
    """One undistorted pinhole photo."""

    name: str  # file name relative to the image folder, the key of the split
    viewmat: np.ndarray  # [4, 4] float32, world to camera, OpenCV axes
    K: np.ndarray  # [3, 3] float32 pixels; pixel centres at +0.5
    image: np.ndarray  # [H, W, 3] uint8 sRGB, straight (un-premultiplied) where there is a matte
    matte: np.ndarray | None = None  # [H, W] uint8 coverage by the object (alpha): composited over the background
    valid: np.ndarray | None = None  # [H, W] uint8, 0 where a pixel must not be used (masks, undistortion border)
    held_out: bool = False  # scored, never trained on

    @property
    def width(self) -> int:
        """Image width in pixels."""
        return self.image.shape[1]

    @property
    def height(self) -> int:
        """Image height in pixels."""
        return self.image.shape[0]


@dataclass(frozen=True)
class Truth:
    """Ground truth beside the images; every part is optional."""

    depths: dict[str, np.ndarray] = field(default_factory=dict)  # name -> [H, W] float32 camera z, 0 where nothing
    normals: dict[str, np.ndarray] = field(default_factory=dict)  # name -> [H, W, 3] float32 camera frame, 0: nothing
    labels: dict[str, np.ndarray] = field(default_factory=dict)  # name -> [H, W] uint8: 0 sky, 255 ground, else object
    points: np.ndarray | None = None  # [P, 3] float32 surface samples, world
    point_normals: np.ndarray | None = None  # [P, 3] float32 unit, world
    point_labels: np.ndarray | None = None  # [P] uint8, 0 object, 1 ground


@dataclass(frozen=True)
class Scene:
    """A loaded data set: frames sorted by name, a sparse point cloud, and the truth if there is one."""

    root: Path
    source: str  # "colmap", "transforms" or "nerf-synthetic"
    frames: tuple[Frame, ...]
    points: np.ndarray  # [P, 3] float32 world
    point_colors: np.ndarray  # [P, 3] uint8
    truth: Truth | None = None

    @property
    def train_frames(self) -> tuple[Frame, ...]:
        """Frames that training may see."""
        return tuple(f for f in self.frames if not f.held_out)

    @property
    def held_out_frames(self) -> tuple[Frame, ...]:
        """Frames kept for scoring."""
        return tuple(f for f in self.frames if f.held_out)


def extent(frames: tuple[Frame, ...]) -> float:
    """Camera extent E = 1.1 max_i |c_i - mean c| over the given frames, scene units (3DGS)."""
    centers = np.stack([-f.viewmat[:3, :3].T @ f.viewmat[:3, 3] for f in frames])
    return float(1.1 * np.linalg.norm(centers - centers.mean(0), axis=1).max())
