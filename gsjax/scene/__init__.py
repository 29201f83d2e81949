"""Records of a data set, independent of its file format: numpy arrays, and functions that read pixels and maps.

Positions, poses and lengths are in local coordinates (`gsjax.scene.similarity`). "World" and "scene units" mean these
coordinates in all other modules.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8

from gsjax.errors import InputError
from gsjax.scene.georeference import UNPLACED, Place
from gsjax.scene.similarity import IDENTITY, Similarity


class Pixels(NamedTuple):
    """What a frame shows."""

    image: UInt8[np.ndarray, "H W 3"]  # sRGB, straight (un-premultiplied) where there is a matte
    matte: UInt8[np.ndarray, "H W"] | None = None  # coverage by the object (alpha): composited over the background
    valid: UInt8[np.ndarray, "H W"] | None = None  # 0 where a pixel must not be used (masks, undistortion border)


Keep = Callable[[np.ndarray], np.ndarray]
"""An array -> the same one where it is to be: in memory, or on the disk (`gsjax.io.temporary_files`)."""


class Origin(NamedTuple):
    """The distorted photo that a frame was undistorted from."""

    photo: tuple[int, int]  # its width and height, pixels
    undistorted: tuple[int, int]  # width and height without distortion and bare border, before a frame is downscaled
    positions: Callable[[], Float32[np.ndarray, "H W 2"]]  # where in the photo, in shares of its width and height,
    # each of the frame's pixel centres is; -1 where the photo shows nothing


class DepthFile(NamedTuple):
    """Depth that was measured with a photo, in a file that the data set lists (`gsjax.io.depth_maps`)."""

    path: Path
    metres: float  # in one unit of the file's values


@dataclass(frozen=True)
class Frame:
    """One undistorted pinhole photo: where it was taken, and how to read its pixels, which are not kept."""

    name: str  # file name relative to the image folder, the key of the split
    viewmat: Float32[np.ndarray, "4 4"]  # world to camera, OpenCV axes
    K: Float32[np.ndarray, "3 3"]  # pixels; pixel centres at +0.5
    width: int  # pixels
    height: int  # pixels
    pixels: Callable[[], Pixels]  # reads them, anew at every call (see `preload`); InputError where it cannot
    held_out: bool = False  # scored, never trained on
    origin: Origin | None = None  # None: the photo had no distortion, the frame shows it whole; or it is a panorama's
    masked: bool = True  # False: all pixels are valid, which is known without reading them
    depth: DepthFile | None = None  # None: the data set lists none


def frame_of(name: str, viewmat: np.ndarray, K: np.ndarray, pixels: Pixels, *, held_out: bool = False) -> Frame:
    """A frame with its pixels in memory."""
    height, width = pixels.image.shape[:2]
    return Frame(name, viewmat, K, width, height, lambda: pixels, held_out, masked=pixels.valid is not None)


def in_memory(array: np.ndarray) -> np.ndarray:
    """A `Keep`: the array itself."""
    return array


def preload(frame: Frame, keep: Keep = in_memory) -> Frame:
    """The same frame with its pixels read now."""
    return with_pixels(frame, Pixels(*(None if each is None else keep(each) for each in frame.pixels())))


def with_pixels(frame: Frame, pixels: Pixels) -> Frame:
    """The same view of something else."""
    return replace(frame, pixels=lambda: pixels, masked=pixels.valid is not None)


def valid_pixels(frame: Frame) -> np.ndarray | None:
    """`[H, W]` bool, which pixels may be used; None for all. The frame is read only where it has a mask.

    Raises:
        InputError: Its photo or mask cannot be read.
    """
    valid = frame.pixels().valid if frame.masked else None
    return None if valid is None else valid > 127


Maps = Mapping[str, Callable[[], np.ndarray]]
"""Frame's name -> function that reads its map."""


@dataclass(frozen=True)
class Truth:
    """Ground truth of the images; every part is optional. Maps are read on each call, and not cached."""

    depths: Maps = field(default_factory=dict)  # frame's name -> [H, W] float32 camera z, 0 where nothing
    normals: Maps = field(default_factory=dict)  # frame's name -> [H, W, 3] float32 camera frame, 0 where nothing
    labels: Maps = field(default_factory=dict)  # frame's name -> [H, W] uint8: 0 sky, 255 ground, else object
    points: Float32[np.ndarray, "P 3"] | None = None  # surface samples that cameras saw, world
    point_normals: Float32[np.ndarray, "P 3"] | None = None  # unit, world
    point_labels: UInt8[np.ndarray, "P"] | None = None  # 0 object, 1 ground
    mesh: Path | None = None  # file of the whole surface as triangles, seen or not; in the files' own coordinates


@dataclass(frozen=True)
class Tracks:
    """Which photo saw which point, and where: the O observations that structure from motion matched."""

    names: tuple[str, ...]  # of photos
    photo: Int32[np.ndarray, "O"]  # index into `names`
    point: Int32[np.ndarray, "O"]  # index into the scene's points
    rays: Float32[np.ndarray, "O 2"]  # x/z and y/z of the keypoint in its photo's camera axes, without lens distortion


@dataclass(frozen=True)
class Scene:
    """A loaded data set: frames sorted by name, a sparse point cloud, and the truth if there is one."""

    root: Path
    source: str  # "colmap", "transforms" or "nerf-synthetic"
    frames: tuple[Frame, ...]
    points: Float32[np.ndarray, "P 3"]  # world
    point_colors: UInt8[np.ndarray, "P 3"]
    truth: Truth | None = None
    tracks: Callable[[], Tracks] | None = None  # reads them; None: nobody matched these points in these photos
    similarity: Similarity = IDENTITY  # to all of this from the coordinates of the world
    place: Place = UNPLACED  # to the world from the coordinates of the files, which it is unless this moves them

    @property
    def train_frames(self) -> tuple[Frame, ...]:
        """Frames that training may see."""
        return tuple(f for f in self.frames if not f.held_out)

    @property
    def held_out_frames(self) -> tuple[Frame, ...]:
        """Frames kept for scoring."""
        return tuple(f for f in self.frames if f.held_out)

    @property
    def extent(self) -> float:
        """Camera extent of the training frames, scene units, see `extent`."""
        return extent(self.train_frames)

    @property
    def camera_centers(self) -> Float64[np.ndarray, "C 3"]:
        """Centres of the frames' cameras in the world."""
        from gsjax.scene.cameras import viewmat_centers  # Loads jax, which a data set is read without.

        viewmats = np.array([frame.viewmat for frame in self.frames], np.float64).reshape(-1, 4, 4)
        return self.similarity.points_to_world(viewmat_centers(viewmats))


def tracks_by_name(scene: Scene) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Photo's name -> `[O]` int64 indices of the points matched in it, and `[O, 2]` float64 rays (`Tracks`).

    Raises:
        InputError: The tracks cannot be read, or name points that the scene does not have.
    """
    if scene.tracks is None:
        return {}
    tracks = scene.tracks()
    if len(tracks.point) and tracks.point.max() >= len(scene.points):
        raise InputError(f"{scene.root}: its tracks name points that it does not have")
    rows = [np.flatnonzero(tracks.photo == index) for index in range(len(tracks.names))]
    return {
        name: (tracks.point[row].astype(np.int64), tracks.rays[row].astype(np.float64))
        for name, row in zip(tracks.names, rows, strict=True)
        if len(row)
    }


def extent(frames: tuple[Frame, ...]) -> float:
    """Camera extent E = 1.1 max_i |c_i - mean c| over the given frames, scene units (3DGS)."""
    from gsjax.scene.cameras import viewmat_center  # Loads jax, which a data set is read without.

    centers = np.stack([viewmat_center(f.viewmat) for f in frames])
    return float(1.1 * np.linalg.norm(centers - centers.mean(0), axis=1).max())
