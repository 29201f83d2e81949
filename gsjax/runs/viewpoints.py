"""Cameras around Gaussians that have none of their own, and circles of cameras around Gaussians and meshes."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from gsjax.gaussians import Gaussians, opacities
from gsjax.rendering import gallery
from gsjax.rendering.coarse_depths import CoarseDepth, depths_at
from gsjax.scene.cameras import Camera, look_at, viewmat_centers
from gsjax.scene.meshes import Mesh, unit_or_zero

COUNT = 32
TURNTABLE_VIEWS = 36
MESH_SIZE = 512  # Side of a view of a mesh, pixels.
MESH_FOCAL = 1.8  # Of a view of a mesh, in widths: 31 degrees.
MESH_ELEVATION = np.radians(20.0)
MESH_MARGIN = 1.05
SIZE = 400  # Side of a view, pixels.
FOCAL = 1.2  # Of a view from outside, in widths: what surrounds the middle fills it.
WIDE_FOCAL = 0.5  # Of a view from inside: a quarter turn.
PROBE_SIZE = 64  # Of the small views by which a viewpoint is chosen.
MUCH_BETTER = 1.5  # So many times as many Gaussians must be seen for an inner place to be preferred.


def cameras_around(gaussians: Gaussians) -> tuple[Camera, ...]:
    """32 cameras that see the opaque Gaussians: an object from outside, or a room from within.

    Three places are tried with small views: a wide sphere about the robust middle, looking in; a close one, between the
    thing in the middle and what surrounds it; the middle itself, looking out. The first is taken unless another shows
    half as many Gaussians again.
    """
    means, middle, radii = _spread(gaussians)
    wide, close = np.quantile(radii, [0.9, 0.5]) * [3.0, 1.5]
    places = (float(wide), 0.0, FOCAL), (float(close), 0.0, FOCAL), (0.0, float(0.1 * np.median(radii)), WIDE_FOCAL)
    counts = [_count_seen(gaussians, means, radii, _cameras_at(middle, *place, PROBE_SIZE)) for place in places]
    best = int(np.argmax(counts))
    return _cameras_at(middle, *places[best if counts[best] > MUCH_BETTER * counts[0] else 0], SIZE)


def _spread(gaussians: Gaussians) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`[M, 3]` opaque, finite means, their median `[3]`, and `[M]` distances from it."""
    means = np.asarray(gaussians.means, np.float64)
    finite = np.isfinite(means).all(axis=1)
    opaque = finite & (np.asarray(opacities(gaussians)) > 0.5)
    means = means[opaque if opaque.any() else finite]
    middle = np.median(means, axis=0)
    return means, middle, np.linalg.norm(means - middle, axis=1)


def _directions() -> np.ndarray:
    """`[COUNT, 3]` unit vectors, evenly spread (a Fibonacci lattice)."""
    height = 1 - 2 * (np.arange(COUNT) + 0.5) / COUNT
    angle, ring = np.pi * (3 - np.sqrt(5)) * np.arange(COUNT), np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), height], -1)


def _cameras_at(middle: np.ndarray, eye: float, target: float, focal: float, size: int) -> tuple[Camera, ...]:
    """Cameras `eye` from the middle in every direction; each faces the point that is `target` from the middle in it."""
    up, K = np.array([0.0, 0.0, 1.0]), _intrinsics(focal, size)
    poses: list[Any] = [look_at(middle + eye * each, middle + target * each, up) for each in _directions()]
    return tuple(Camera(viewmat, K, size, size) for viewmat in poses)


def _intrinsics(focal: float, size: int) -> Any:
    """`[3, 3]` of a square view."""
    return np.array([[focal * size, 0, size / 2], [0, focal * size, size / 2], [0, 0, 1]], np.float32)


def _count_seen(gaussians: Gaussians, means: np.ndarray, radii: np.ndarray, cameras: tuple[Camera, ...]) -> int:
    """How many means are on the rendered depth of some view."""
    near = np.full(len(means), 0.02 * np.median(radii))
    # Means are compared, so the depth is theirs.
    pictures = gallery.pictures(gaussians, cameras, np.zeros(3, np.float32), "center")
    visible = np.zeros(len(means), bool)
    for camera, picture in zip(cameras, pictures, strict=True):
        depths, rendered = depths_at(means, CoarseDepth(camera, picture.depth))
        visible |= (rendered > 0) & (np.abs(rendered - depths) < near)
    return int(visible.sum())


def camera_circle(gaussians: Gaussians, cameras: Sequence[Camera]) -> list[Camera]:
    """A circle of cameras at the mean height and distance of the run's own, around the middle of the opaque part."""
    middle = opaque_middle(gaussians)
    views = np.stack([np.asarray(c.viewmat) for c in cameras])
    centers = viewmat_centers(views)
    up = mean_up(cameras)
    offsets = centers - middle
    height = float((offsets @ up).mean())
    flat = offsets - (offsets @ up)[:, None] * up
    radius = float(np.linalg.norm(flat, axis=1).mean())
    poses = _circle(middle, up, flat[0] / np.linalg.norm(flat[0]), radius, height)
    return [Camera(viewmat, cameras[0].K, cameras[0].width, cameras[0].height) for viewmat in poses]


def camera_circle_of_mesh(mesh: Mesh, up: np.ndarray) -> list[Camera]:
    """A circle of square views, 20 degrees above the middle of a mesh, each of which holds the whole mesh.

    The circle ignores the farthest hundredth of the vertices on every side, so outliers do not shrink the rest.
    `up`, `[3]` of any length, is up in the pictures.
    """
    low, high = np.quantile(mesh.vertices[np.unique(mesh.faces)].astype(np.float64), [0.01, 0.99], axis=0)
    size = max(float(np.linalg.norm(high - low)), 1e-12)
    distance = MESH_MARGIN * size / 2 * float(np.hypot(1, 2 * MESH_FOCAL))
    up = unit_or_zero(np.asarray(up, np.float64))
    aside = unit_or_zero(np.cross(up, np.eye(3)[np.argmin(np.abs(up))]))
    radius, height = distance * np.cos(MESH_ELEVATION), distance * np.sin(MESH_ELEVATION)
    poses = _circle((low + high) / 2, up, aside, radius, height)
    K = _intrinsics(MESH_FOCAL, MESH_SIZE)
    return [Camera(viewmat, K, MESH_SIZE, MESH_SIZE) for viewmat in poses]


def _circle(middle: np.ndarray, up: np.ndarray, first: np.ndarray, radius: float, height: float) -> Iterator[Any]:
    """`[4, 4]` world to camera, of cameras that face the middle; the first is in the unit direction `first`."""
    second = np.cross(up, first)
    for angle in 2 * np.pi * np.arange(TURNTABLE_VIEWS) / TURNTABLE_VIEWS:
        outward = np.cos(angle) * first + np.sin(angle) * second
        yield look_at(middle + radius * outward + height * up, middle, up)


def evenly_spread(count: int, most: int) -> list[int]:
    """Indices of at most so many of `count` things, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int)).tolist()


def mean_up(cameras: Sequence[Camera]) -> np.ndarray:
    """`[3]` unit float64, world: what is up in the pictures of cameras, on average.

    Of cameras that are in all directions there is no such thing; theirs is that of the first.
    """
    ups = -np.stack([np.asarray(camera.viewmat, np.float64)[1, :3] for camera in cameras])
    length = np.linalg.norm(ups.mean(axis=0))
    return ups.mean(axis=0) / length if length > 1e-6 else ups[0]


def opaque_middle(gaussians: Gaussians) -> np.ndarray:
    """`[3]` median of the opaque Gaussians' means, or of all where none is; world."""
    opaque = np.asarray(opacities(gaussians)) > 0.5
    means = np.asarray(gaussians.means)
    return np.median(means[opaque] if opaque.any() else means, axis=0)
