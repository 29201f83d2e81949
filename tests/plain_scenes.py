"""Rooms with plain ceilings and walls, and places under an open sky, ray cast in numpy: boxes, cameras and tracks."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsjax.scene import Frame, Pixels, Scene, Tracks, frame_of
from gsjax.scene.cameras import look_at

SIZE, FOCAL = (120, 90), 95.0
POINTS, CONTRAST, POINT_NOISE = 5000, 6.0, 0.01  # drawn, of which those stay that photos show contrast at; shares

Paint = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(points `[R, 3]`, axis of the normal `[R]`) -> display-coded colours `[R, 3]`, 0..1."""


class Box(NamedTuple):
    """A box with sides along the axes, metres, z up."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    paint: Paint
    inside: bool = False  # seen from within, as a room is
    mirror: bool = False  # its upright sides reflect what is behind all


class Place(NamedTuple):
    """What is photographed, and from where."""

    boxes: tuple[Box, ...]
    eyes: np.ndarray  # [V, 3]
    targets: np.ndarray  # [V, 3]
    sky: Callable[[np.ndarray], np.ndarray] | None = None  # unit directions [R, 3] -> colours [R, 3]; None: black


def grain(points: np.ndarray) -> np.ndarray:
    """`[R]` a pattern -1..1 that keypoints are matched on."""
    x, y, z = points.T
    wave = np.sin(7 * x + 3 * y) * np.sin(5 * y - 4 * z + 1) + 0.8 * np.sin(17 * x - 11 * z) * np.sin(15 * y + 13 * z)
    return np.clip(wave, -1, 1)


def textured(low=(0.25, 0.2, 0.15), high=(0.65, 0.55, 0.45)) -> Paint:
    """Patterned all over."""

    def paint(points, axis):
        mix = 0.5 + 0.5 * grain(points)[:, None]
        return np.array(low) * (1 - mix) + np.array(high) * mix

    return paint


def plaster(color, light=None) -> Paint:
    """One colour, times the light at the place: `light(points, axis)` `[R]`."""

    def paint(points, axis):
        bright = np.ones(len(points)) if light is None else light(points, axis)
        return np.clip(bright[:, None] * np.array(color), 0, 1)

    return paint


def lamp(at, reach: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Light that falls off about a place."""
    return lambda points, axis: 0.55 + 0.45 / (1 + np.square(points - np.array(at)).sum(1) / reach**2)


def split(is_one: Callable[[np.ndarray, np.ndarray], np.ndarray], one: Paint, other: Paint) -> Paint:
    """One paint where `is_one(points, axis)`, another one elsewhere."""
    return lambda points, axis: np.where(is_one(points, axis)[:, None], one(points, axis), other(points, axis))


def photograph(place: Place, *, gains=0.0) -> tuple[Scene, list[np.ndarray]]:
    """The scene with its tracks, and `[H, W]` bool a photo: which pixels show what is behind all.

    `gains` is the standard deviation of the photos' exposures, EV.
    """
    rng = np.random.default_rng(0)
    frames, truths = [], []
    for index, (eye, target) in enumerate(zip(place.eyes, place.targets, strict=True)):
        viewmat = look_at(np.asarray(eye, float), np.asarray(target, float), np.array([0.0, 0.0, 1.0]))
        image, truth = _photo(place, viewmat, 2 ** (gains * rng.normal() / 2.2))
        image = np.rint(np.clip(image + rng.normal(size=image.shape), 0, 255)).astype(np.uint8)
        frames.append(frame_of(f"{index:02d}.png", viewmat.astype(np.float32), _intrinsics(), Pixels(image)))
        truths.append(truth)
    points, tracks = _tracks(place, frames, rng)
    colors = np.full((len(points), 3), 128, np.uint8)
    return Scene(Path("place"), "colmap", tuple(frames), points, colors, tracks=lambda: tracks), truths


def _intrinsics() -> np.ndarray:
    return np.array([[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]], np.float32)


def cast(boxes, origin: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances `[R]` (infinite: nothing), which box `[R]` and the axis of its normal `[R]`."""
    far, which, axes = np.full(len(rays), np.inf), np.zeros((2, len(rays)), int)[0], np.zeros(len(rays), int)
    with np.errstate(divide="ignore", invalid="ignore"):
        for number, box in enumerate(boxes):
            to_low, to_high = (np.array(box.low) - origin) / rays, (np.array(box.high) - origin) / rays
            enters, leaves = np.minimum(to_low, to_high), np.maximum(to_low, to_high)
            axis, away = (leaves.argmin(1), leaves.min(1)) if box.inside else (enters.argmax(1), enters.max(1))
            met = (away > 1e-6) & (away < far) & (box.inside | (enters.max(1) <= leaves.min(1)))
            far, which, axes = np.where(met, away, far), np.where(met, number, which), np.where(met, axis, axes)
    return far, which, axes


def _photo(place: Place, viewmat: np.ndarray, gain: float) -> tuple[np.ndarray, np.ndarray]:
    """`[H, W, 3]` float 0..255, means of two rays a pixel, and where nothing is met."""
    origin, images, misses = -viewmat[:3, :3].T @ viewmat[:3, 3], [], []
    for dx, dy in ((0.25, 0.25), (0.75, 0.75)):
        x, y = np.meshgrid(
            (np.arange(SIZE[0]) + dx - SIZE[0] / 2) / FOCAL, (np.arange(SIZE[1]) + dy - SIZE[1] / 2) / FOCAL
        )
        rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ viewmat[:3, :3]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        far, which, axes = cast(place.boxes, origin, rays)
        colors = place.sky(rays) if place.sky else np.zeros_like(rays)
        for number, box in enumerate(place.boxes):
            rows = np.isfinite(far) & (which == number)
            points = origin + far[rows, None] * rays[rows]
            colors[rows] = box.paint(points, axes[rows])
            if box.mirror and place.sky:
                turned = rays[rows] * np.where(np.arange(3) == axes[rows, None], -1, 1)
                glass = (axes[rows] < 2) & (colors[rows, 0] < 0)  # painted negative: a pane
                colors[rows] = np.where(glass[:, None], 0.7 * place.sky(turned), colors[rows])
        images.append(255 * np.clip(gain * colors, 0, 1))
        misses.append(~np.isfinite(far))
    shape = (SIZE[1], SIZE[0])
    return np.mean(images, 0).reshape(*shape, 3), np.all(misses, 0).reshape(shape)


def _tracks(place: Place, frames: list[Frame], rng) -> tuple[np.ndarray, Tracks]:
    """Points on what has contrast in three photos at least."""
    points = _on_surfaces(place.boxes, rng)
    is_visible = np.zeros((len(frames), len(points)), bool)
    rays = np.zeros((len(frames), len(points), 2))
    for index, frame in enumerate(frames):
        viewmat = frame.viewmat.astype(np.float64)
        eye = -viewmat[:3, :3].T @ viewmat[:3, 3]
        local = points @ viewmat[:3, :3].T + viewmat[:3, 3]
        rays[index] = local[:, :2] / np.maximum(local[:, 2:], 1e-3)
        pixels = rays[index] * FOCAL + np.array(SIZE) / 2
        inside = (local[:, 2] > 0.05) & ((pixels > 2) & (pixels < np.array(SIZE) - 3)).all(1)
        away = points - eye
        free = cast(place.boxes, eye, away)[0] > 1 - 1e-3
        slopes = np.hypot(*np.gradient(frame.pixels().image.mean(-1)))
        x, y = np.where(inside[:, None], pixels, 0).astype(int).T
        is_visible[index] = inside & free & (slopes[y, x] > CONTRAST)
    indices = np.flatnonzero(is_visible.sum(0) >= 3)
    photo, point = np.nonzero(is_visible[:, indices])
    noisy_rays = rays[photo, indices[point]] + rng.normal(0, 0.2 / FOCAL, (len(photo), 2))
    tracks = Tracks(
        tuple(f.name for f in frames), photo.astype(np.int32), point.astype(np.int32), noisy_rays.astype(np.float32)
    )
    return (points[indices] * (1 + POINT_NOISE * rng.normal(size=(len(indices), 1)))).astype(np.float32), tracks


def _on_surfaces(boxes, rng) -> np.ndarray:
    """`[POINTS, 3]` drawn over the boxes' sides by their area, no side's share over a third."""
    sides, areas = [], []
    for box in boxes:
        low, high = np.array(box.low, float), np.array(box.high, float)
        for axis in range(3):
            for end in (low, high):
                others = np.delete(high - low, axis)
                sides.append((low, high, axis, end[axis]))
                areas.append(min(others[0], 30) * min(others[1], 30))
    shares = np.minimum(np.array(areas) / np.sum(areas), 1 / 3)
    parts = []
    for (low, high, axis, end), share in zip(sides, shares, strict=True):
        part = rng.uniform(np.maximum(low, -30), np.minimum(high, 30), (int(share * POINTS) + 30, 3))
        part[:, axis] = end
        parts.append(part)
    return np.concatenate(parts)


def walk(count: int, radius, height: float):
    """Eyes and targets of a walk about the middle, each looking another way and a little up."""
    angles = 2 * np.pi * np.arange(count) / count
    rx, ry = np.broadcast_to(radius, 2)
    eyes = np.stack([rx * np.cos(angles), ry * np.sin(angles), height + 0.1 * np.sin(3 * angles)], 1)
    ways = angles + 2.4 * np.arange(count)
    return eyes, eyes + np.stack([2 * np.cos(ways), 2 * np.sin(ways), np.full(count, 0.25)], 1)


def ring(count: int, radius: float, height: float, target=(0.0, 0.0, 1.0), arc=2 * np.pi):
    """Eyes on a circle, and targets near one place."""
    angles = np.linspace(0, arc, count, endpoint=arc < 6)
    far = radius * (1 + 0.1 * np.sin(5 * angles))
    eyes = np.stack([far * np.cos(angles), far * np.sin(angles), height + 0.1 * np.cos(4 * angles)], 1)
    return eyes, np.array(target) + 0.2 * np.stack([np.sin(3 * angles), np.cos(2 * angles), np.sin(angles)], 1)
