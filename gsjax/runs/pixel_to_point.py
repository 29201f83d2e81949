"""The point of the surface that a photo shows at a pixel: by triangulated points, or by a run's rendered depth."""

from collections.abc import Callable, Iterable
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np

from gsjax.errors import InputError
from gsjax.rendering import gallery
from gsjax.runs.result import open_result, scene_of_run
from gsjax.runs.run import Run
from gsjax.scene import Frame, Scene
from gsjax.scene.cameras import Camera
from gsjax.scene.similarity import Similarity

NEAR = 0.04  # of a photo's longer side: a triangulated point farther from a pixel does not tell its depth


class Pixel(NamedTuple):
    """A pixel of a photo."""

    photo: str  # its name in the data set; its file's name, or that without ending, where one photo alone has it
    x: float  # pixels of the photo as it is in the data set, from its left edge
    y: float  # from its upper edge

    def __str__(self) -> str:
        return f"{self.photo} {self.x:g} {self.y:g}"


PointAt = Callable[[Pixel], np.ndarray]
"""A pixel -> the point `[3]` float64 of the world that it shows; InputError where that is not known."""


def points_of_scene(scene: Scene) -> PointAt:
    """Points on the rays of pixels, as far away as the triangulated point that the photo shows nearest to each.

    Raises:
        InputError: The data set has no triangulated points.
    """
    if scene.tracks is None:
        raise InputError(f"{scene.root}: holds no triangulated points that photos see; train on it, and scale the run")
    tracks, frames = scene.tracks(), {frame.name: frame for frame in scene.frames}

    def point_at(pixel: Pixel) -> np.ndarray:
        frame = frames[_name_of(pixel.photo, frames, scene.root)]
        ray = _ray(frame, *_pixel_of(frame, pixel, 1.0))
        is_seen = tracks.photo == (tracks.names.index(frame.name) if frame.name in tracks.names else -1)
        if not is_seen.any():
            raise InputError(f"{scene.root}: no triangulated point is seen in {frame.name}")
        off = np.linalg.norm((tracks.rays[is_seen] - ray) * frame.K[[0, 1], [0, 1]], axis=1)
        nearest, most = int(off.argmin()), NEAR * max(frame.width, frame.height)
        if off[nearest] > most:
            raise InputError(
                f"{pixel}: no triangulated point is seen within {most:.0f} pixels, the nearest is"
                f" {off[nearest]:.0f} away; choose a pixel with more texture"
            )
        point = scene.points[tracks.point[is_seen][nearest]]
        return _in_world(scene.similarity, frame, ray, float(frame.viewmat[2, :3] @ point + frame.viewmat[2, 3]))

    return point_at


def points_of_run(folder: Path) -> PointAt:
    """Points on the rays of pixels, as far away as the Gaussians of a finished run show a surface."""
    result, run = open_result(folder), Run.open(folder)
    cameras = dict(zip(result.names, result.cameras, strict=True))
    try:
        frames = {frame.name: frame for frame in scene_of_run(folder).frames}
    except InputError:  # Its photos are gone, and with them what their lens did to pixels.
        frames = {}

    def point_at(pixel: Pixel) -> np.ndarray:
        name = _name_of(pixel.photo, cameras, folder)
        camera = cameras[name]
        x, y = _pixel_of(frames.get(name, camera), pixel, run.downscale)
        (picture,) = gallery.pictures(result.gaussians, [camera], result.background, result.depth_mode)
        depth = float(picture.depth[int(y), int(x)])
        if not depth > 0:
            raise InputError(f"{pixel}: the run shows no surface there")
        return _in_world(result.similarity, camera, _ray(camera, x, y), depth)

    return point_at


def _name_of(photo: str, names: Iterable[str], where: Path) -> str:
    """The one photo that is meant."""
    paths = [PurePosixPath(name) for name in names]
    for meant in (
        [path for path in paths if str(path) == photo],
        [path for path in paths if path.name == PurePosixPath(photo).name],
        [path for path in paths if path.stem == photo],
    ):
        if len(meant) == 1:
            return str(meant[0])
        if meant:
            raise InputError(f"{where}: {len(meant)} photos are called {photo}: {', '.join(map(str, meant[:3]))}")
    raise InputError(f"{where}: has no photo {photo}; one is called {paths[0]}")


def _pixel_of(view: Frame | Camera, pixel: Pixel, downscale: float) -> tuple[float, float]:
    """Where a frame or a camera of a run shows what the photo shows at a pixel, pixels."""
    if isinstance(view, Frame) and view.origin is not None:
        width, height = view.origin.photo
        shares = np.array([pixel.x, pixel.y]) / view.origin.photo
        off = np.linalg.norm(view.origin.positions() - shares, axis=-1)
        row, column = np.unravel_index(int(off.argmin()), off.shape)
        inside = off.min() < 2 / min(view.width, view.height)
        x, y = column + 0.5, row + 0.5
    else:
        width, height = round(view.width * downscale), round(view.height * downscale)
        x, y = pixel.x / downscale, pixel.y / downscale
        inside = 0 <= x < view.width and 0 <= y < view.height
    if not inside:
        raise InputError(f"{pixel}: is outside the photo, which is {width}x{height}")
    return float(x), float(y)


def _ray(view: Frame | Camera, x: float, y: float) -> np.ndarray:
    """`[2]` x/z and y/z of a pixel, camera axes."""
    K = np.asarray(view.K, np.float64)
    return (np.array([x, y]) - K[:2, 2]) / K[[0, 1], [0, 1]]


def _in_world(similarity: Similarity, view: Frame | Camera, ray: np.ndarray, depth: float) -> np.ndarray:
    viewmat = np.asarray(view.viewmat, np.float64)
    return similarity.points_to_world((depth * np.array([*ray, 1.0]) - viewmat[:3, 3]) @ viewmat[:3, :3])
