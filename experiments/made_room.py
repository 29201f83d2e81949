"""A furnished room that is known exactly, photographed all around and through a fisheye lens."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsjax.cameras import look_at, viewmat_center
from gsjax.colors import to_bytes
from gsjax.io.colmap_writer import write_whole
from gsjax.io.files import make_folder
from gsjax.io.images import cv2, write_image
from gsjax.io.lenses import Lens, pycolmap_camera
from gsjax.io.packages import require

# Boxes by their corners, metres, z up: the room itself, seen from within, and what stands in it.
BOXES = np.array([
    [[-3.0, -2.5, 0.0], [3.0, 2.5, 2.8]],
    [[-2.6, -2.2, 0.0], [-1.6, -1.5, 0.9]],
    [[1.2, 1.2, 0.0], [2.4, 2.2, 0.5]],
    [[1.9, -2.3, 0.0], [2.6, -1.7, 1.8]],
    [[-1.2, 1.6, 0.9], [0.2, 2.4, 1.5]],
])  # fmt: skip
TEXELS, SAMPLES = 512, 2  # a side of a surface's texture; of a pixel
BLOTCHES = {4: 0.08, 9: 0.07, 19: 0.06, 41: 0.05, 89: 0.035, 181: 0.02}  # across a surface, by their contrast
FISHEYE_DEGREES = 120.0  # from one edge of the picture to the other: the corners lie 85 degrees from the axis
OPERATOR_BELOW, OPERATOR_COLOR = 62.0, (0.9, 0.5, 0.1)  # degrees below the horizon: farther down only he is seen
POINTS = 400  # that a fisheye photo adds to its model


class Seen(NamedTuple):
    """What rays meet."""

    colors: np.ndarray  # [R, 3] float32, 0..1
    distances: np.ndarray  # [R] in lengths of the ray's direction


def room_lens(kind: str, width: int) -> Lens:
    """The lens of `"panorama"` or `"fisheye"` photos (equidistant, square) of this width in pixels."""
    if kind == "panorama":
        return Lens("EQUIRECTANGULAR", width, width // 2, (float(width), width / 2))
    focal, middle = width / np.radians(FISHEYE_DEGREES), width / 2
    return Lens("OPENCV_FISHEYE", width, width, (focal, focal, middle, middle, 0.0, 0.0, 0.0, 0.0))


def pixel_rays(lens: Lens, dx: float = 0.5, dy: float = 0.5) -> np.ndarray:
    """`[H, W, 3]` unit directions in the camera's axes, through that place of every pixel."""
    x, y = np.meshgrid(np.arange(lens.width) + dx, np.arange(lens.height) + dy)
    rays = np.asarray(pycolmap_camera(lens).cam_ray_from_img(np.stack([x.ravel(), y.ravel()], axis=1)))
    return rays.reshape(lens.height, lens.width, 3)


def poses(count: int) -> list[np.ndarray]:
    """`[4, 4]` world to camera of a walk around the room, level, each looking another way."""
    turns = 2 * np.pi * np.arange(count) / count
    eyes = np.stack([1.1 * np.cos(turns), 0.8 * np.sin(turns), 1.5 + 0.15 * np.sin(3 * turns)], axis=1)
    looks = turns + 2.4 * np.arange(count)
    ahead = np.stack([np.cos(looks), np.sin(looks), np.zeros(count)], axis=1)
    return [look_at(eye, eye + forward, np.array([0.0, 0, 1])) for eye, forward in zip(eyes, ahead, strict=True)]


def surface_textures() -> np.ndarray:
    """`[boxes, 6, TEXELS, TEXELS, 3]` float32: blotches of all sizes, in a colour of each side's own."""
    rng = np.random.default_rng(0)
    made = np.empty((len(BOXES), 6, TEXELS, TEXELS, 3), np.float32)
    for side in made.reshape(-1, TEXELS, TEXELS, 3):
        side[:] = rng.uniform(0.3, 0.75, 3)
        for size, contrast in BLOTCHES.items():
            coarse = contrast * (rng.normal(size=(size, size, 1)) + 0.2 * rng.normal(size=(size, size, 3)))
            side += cv2.resize(coarse, (TEXELS, TEXELS), interpolation=cv2.INTER_CUBIC)
    return np.clip(made, 0, 1)


def look_along(viewmat: np.ndarray, rays: np.ndarray, textures: np.ndarray) -> Seen:
    """The nearest side of a box on each ray `[R, 3]`, in a camera's axes; the room is met from within."""
    origin, directions = viewmat_center(viewmat), rays @ viewmat[:3, :3]
    distances, colors = np.full(len(rays), np.inf), np.zeros((len(rays), 3), np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        for box, (low, high) in enumerate(BOXES):
            to_low, to_high = (low - origin) / directions, (high - origin) / directions
            enters, leaves = np.minimum(to_low, to_high), np.maximum(to_low, to_high)
            axes, away = (leaves.argmin(1), leaves.min(1)) if box == 0 else (enters.argmax(1), enters.max(1))
            met = (away > 0) & (away < distances) & ((enters.max(1) <= leaves.min(1)) | (box == 0))
            rows, axis = np.flatnonzero(met), axes[met]
            points = (origin + away[rows, None] * directions[rows] - low) / (high - low)
            across = np.where(axis == 0, points[:, 1], points[:, 0]), np.where(axis == 2, points[:, 1], points[:, 2])
            u, v = np.clip((np.stack(across) * TEXELS).astype(int), 0, TEXELS - 1)
            side = 2 * axis + (points[np.arange(len(rows)), axis] > 0.5)
            distances[rows], colors[rows] = away[rows], textures[box, side, u, v]
    return Seen(colors, distances)


def true_photo(lens: Lens, viewmat: np.ndarray, textures: np.ndarray) -> np.ndarray:
    """`[H, W, 3]` float64, 0..1, each pixel the mean over its area."""
    offsets = (np.arange(SAMPLES) + 0.5) / SAMPLES
    looks = [look_along(viewmat, pixel_rays(lens, dx, dy).reshape(-1, 3), textures).colors
             for dy in offsets for dx in offsets]  # fmt: skip
    return np.mean(looks, axis=0, dtype=np.float64).reshape(lens.height, lens.width, 3)


def write_photos(kind: str, out: Path, count: int, width: int) -> None:
    """Panoramas, with an operator, into OUT; or fisheye photos into OUT/images and their model into OUT/sparse/0."""
    lens, textures = room_lens(kind, width), surface_textures()
    folder = out if kind == "panorama" else out / "images"
    make_folder(folder)
    for step, viewmat in enumerate(poses(count)):
        photo = true_photo(lens, viewmat, textures)
        if kind == "panorama":
            photo[is_below(lens, OPERATOR_BELOW)] = OPERATOR_COLOR
        write_image(folder / f"{step:03d}.png", to_bytes(photo))
    if kind == "fisheye":
        _write_model(out / "sparse/0", lens, count)


def is_below(lens: Lens, degrees: float) -> np.ndarray:
    """`[H, W]` bool: a panorama's pixels that far and farther below the horizon."""
    return pixel_rays(lens)[..., 1] >= np.sin(np.radians(degrees))


def _write_model(folder: Path, lens: Lens, count: int) -> None:
    """The true cameras, and grey points of the surfaces without tracks."""
    pycolmap = require("pycolmap", "pip install pycolmap")
    model, camera = pycolmap.Reconstruction(), pycolmap_camera(lens)
    camera.camera_id = 1
    model.add_camera_with_trivial_rig(camera)
    for step, viewmat in enumerate(poses(count)):
        image = pycolmap.Image(name=f"{step:03d}.png", camera_id=1, image_id=step + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(viewmat[:3]))
    rng, textures = np.random.default_rng(1), surface_textures()
    for viewmat in poses(count):
        rays = rng.normal(size=(POINTS, 3))
        seen = look_along(viewmat, rays, textures)
        for point in viewmat_center(viewmat) + seen.distances[:, None] * (rays @ viewmat[:3, :3]):
            model.add_point3D(point, pycolmap.Track(), np.full(3, 128, np.uint8))
    write_whole(model, folder)
