"""A painted wall in numpy: every pixel, keypoint and effect of it has a closed form."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gsjax.io.colmap_writer import write_model
from gsjax.io.images import write_image
from gsjax.scene import Frame, Pixels, Scene, Tracks, frame_of, with_pixels

SIZE, FOCAL = (96, 72), 80.0


def wall(num_photos: int = 12, *, num_points: int = 400) -> Scene:
    """Photos of the plane z = 0, by cameras that look along +z from 3 away, and points on it, seen wherever in view."""
    rng = np.random.default_rng(0)
    eyes = np.c_[rng.uniform(-0.8, 0.8, (num_photos, 2)), np.full(num_photos, -3.0)]
    frames = tuple(_photo(f"{index:02d}.png", eye) for index, eye in enumerate(eyes))
    points = np.c_[rng.uniform((-2, -1.2), (2, 1.2), (num_points, 2)), np.zeros(num_points)]
    photo, point, rays = [], [], []
    for index, frame in enumerate(frames):
        ray = (points - eyes[index])[:, :2] / -eyes[index, 2]
        pixels = ray * FOCAL + frame.K[:2, 2]
        inside = np.flatnonzero(((pixels > 3) & (pixels < np.array(SIZE) - 3)).all(-1))
        photo.append(np.full(len(inside), index, np.int32))
        point.append(inside.astype(np.int32))
        rays.append(ray[inside].astype(np.float32))
    tracks = Tracks(tuple(f.name for f in frames), *(np.concatenate(part) for part in (photo, point, rays)))
    colors = np.full((num_points, 3), 128, np.uint8)
    return Scene(Path("wall"), "colmap", frames, points.astype(np.float32), colors, tracks=lambda: tracks)


def write_wall(scene: Scene, folder: Path) -> Path:
    """The scene as a data set on disk: a COLMAP model and its photos."""
    write_model(folder / "sparse/0", scene.frames, scene.points, scene.point_colors)
    for frame in scene.frames:
        write_image(folder / "images" / frame.name, frame.pixels().image)
    return folder


def relit(scene: Scene, stops) -> Scene:
    """The scene with the light of every pixel changed by `stops(index, frame, x, y)` EV: `[3]` or `[H, W, 3]`."""
    frames = []
    for index, frame in enumerate(scene.frames):
        x, y = np.meshgrid(np.arange(frame.width) + 0.5, np.arange(frame.height) + 0.5)
        pixels = frame.pixels()
        light = _light(pixels.image / 255) * 2 ** np.asarray(stops(index, frame, x, y))
        frames.append(with_pixels(frame, pixels._replace(image=_coded(light))))
    return replace(scene, frames=tuple(frames))


def with_tracks(scene: Scene, rows: np.ndarray | slice) -> Scene:
    """The scene with these of its observations alone."""
    tracks = scene.tracks()
    fewer = replace(tracks, photo=tracks.photo[rows], point=tracks.point[rows], rays=tracks.rays[rows])
    return replace(scene, tracks=lambda: fewer)


def turned(scene: Scene, degrees: float, seed: int) -> Scene:
    """Every camera turned about its three axes by angles of this standard deviation."""
    rng, frames = np.random.default_rng(seed), []
    for frame in scene.frames:
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(np.radians(degrees) * rng.normal(size=3)).as_matrix()
        frames.append(replace(frame, viewmat=(turn @ frame.viewmat).astype(np.float32)))
    return replace(scene, frames=tuple(frames))


def gains(scene: Scene, exposure: float, balance: float = 0.0, seed: int = 1) -> np.ndarray:
    """`[V, 3]` EV drawn with these standard deviations, mean zero."""
    rng = np.random.default_rng(seed)
    samples = exposure * rng.normal(size=(len(scene.frames), 1)) + balance * rng.normal(size=(len(scene.frames), 3))
    return samples - samples.mean(0)


def radii2(frame: Frame, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """`[H, W, 1]` squared distance from the principal point, 1 at half a diagonal."""
    from_center = (x - frame.K[0, 2]) ** 2 + (y - frame.K[1, 2]) ** 2
    return from_center[..., None] * 4 / (frame.width**2 + frame.height**2)


def _photo(name: str, eye: np.ndarray) -> Frame:
    width, height = SIZE
    K = np.array([[FOCAL, 0, width / 2], [0, FOCAL, height / 2], [0, 0, 1]], np.float32)
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[:3, 3] = -eye
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    u, v = (
        (axis - center) / FOCAL * -eye[2] + origin for axis, center, origin in zip((x, y), K[:2, 2], eye, strict=False)
    )
    waves = np.stack([np.sin(3 * u + v), np.sin(2 * v - u + 1), np.cos(2.5 * u - 2 * v)], -1)
    return frame_of(name, viewmat, K, Pixels(_coded(0.13 + 0.04 * waves)))


def _coded(light: np.ndarray) -> np.ndarray:
    light = np.clip(light, 0, 1)
    coded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(255 * coded).astype(np.uint8)


def _light(coded: np.ndarray) -> np.ndarray:
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
