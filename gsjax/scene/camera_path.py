"""Smooth flights of a camera through keyframes: splines of places, of rotations and of the angle of view."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from gsjax.scene.cameras import Camera, viewmat_center

PAD = 3  # Keyframes of a closed flight that are met again before its beginning and after its end, for the rotations.
LEAST_STEP = 1e-3  # Of the mean way between keyframes: two at one place are still passed one after the other.


class Keyframes(NamedTuple):
    """Where a flight leads through, in order."""

    viewmats: np.ndarray  # [K, 4, 4] float64 world to camera, K at least 2; at least 3 of a closed flight
    fovs: np.ndarray  # [K] float64 vertical angle of view, radians
    closed: bool  # whether it comes back to the first


def fly(keyframes: Keyframes, count: int) -> tuple[np.ndarray, np.ndarray]:
    """`[count, 4, 4]` float64 viewmats and `[count]` vertical angles along a flight, at about one speed.

    Places follow a cubic spline and rotations one with continuous angular acceleration (scipy's `RotationSpline`), both
    over the length of the way: scene units, and half turns times the mean distance between keyframes. The first is the
    first keyframe. The last is the last one; of a closed flight it is one step before the first.
    """
    viewmats, fovs, closed = keyframes
    centers = np.stack([viewmat_center(viewmat) for viewmat in viewmats])
    turns = Rotation.from_matrix(viewmats[:, :3, :3].transpose(0, 2, 1))
    order = np.arange(len(viewmats) + closed) % len(viewmats)
    centers, turns, fovs = centers[order], turns[order], fovs[order]
    times = np.concatenate([[0.0], np.cumsum(_steps(centers, turns))])
    at = np.linspace(0, times[-1], count, endpoint=not closed)
    places = CubicSpline(times, centers, bc_type="periodic" if closed else "natural")(at)
    angles = CubicSpline(times, fovs, bc_type="periodic" if closed else "natural")(at)
    rotations = _rotation_spline(times, turns, closed)(at).as_matrix().transpose(0, 2, 1)
    flown = np.tile(np.eye(4), (count, 1, 1))
    flown[:, :3, :3] = rotations
    flown[:, :3, 3] = -np.einsum("nij,nj->ni", rotations, places)
    return flown, np.clip(angles, fovs.min(), fovs.max())


def at_all(cameras: Sequence[Camera], aspect: float, *, closed: bool) -> Keyframes:
    """Keyframes at all cameras, in their order; in pictures of this width by height each shows all that it shows."""
    viewmats = np.stack([np.asarray(camera.viewmat, np.float64) for camera in cameras])
    return Keyframes(viewmats, np.array([covering_fov(camera, aspect) for camera in cameras]), closed)


def through(cameras: Sequence[Camera], most: int, aspect: float) -> Keyframes:
    """`at_all` of `most` of the cameras, evenly spread; in their own order, or from each to the nearest if shorter."""
    indices = np.unique(np.linspace(0, len(cameras) - 1, min(most, len(cameras))).round().astype(int))
    keyframes = at_all([cameras[place] for place in indices], aspect, closed=False)
    order = _shorter_order(np.stack([viewmat_center(viewmat) for viewmat in keyframes.viewmats]))
    return keyframes._replace(viewmats=keyframes.viewmats[order], fovs=keyframes.fovs[order])


def camera_of(viewmat: np.ndarray, fov: float, width: int, height: int) -> Camera:
    """The camera of a picture of this size, from where a flight is: `[4, 4]` world to camera, and radians."""
    focal = height / 2 / np.tan(fov / 2)
    K: Any = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], np.float32)
    pose: Any = viewmat.astype(np.float32)
    return Camera(pose, K, width, height)


def covering_fov(camera: Camera, aspect: float) -> float:
    """The vertical angle of view, radians, of a picture of this aspect that holds all that a camera sees."""
    right, down = camera.width / 2 / float(camera.K[0, 0]), camera.height / 2 / float(camera.K[1, 1])
    return 2 * float(np.arctan(max(down, right / aspect)))


def _steps(centers: np.ndarray, turns: Rotation) -> np.ndarray:
    """`[K - 1]` lengths of the way between keyframes, none of them 0."""
    ways = np.linalg.norm(np.diff(centers, axis=0), axis=1)
    halves = (turns[:-1].inv() * turns[1:]).magnitude() / np.pi
    steps = ways + halves * (ways.mean() or 1.0)
    return np.maximum(steps, LEAST_STEP * (steps.mean() or 1.0))


def _rotation_spline(times: np.ndarray, turns: Rotation, closed: bool) -> RotationSpline:
    if not closed:
        return RotationSpline(times, turns)
    count = len(times) - 1
    around = np.arange(-PAD, count + PAD + 1)
    laps, places = np.divmod(around, count)
    return RotationSpline(times[places] + laps * times[-1], turns[places])


def _shorter_order(centers: np.ndarray) -> np.ndarray:
    """`[K]` indices: the order as it is, or from each to the nearest that is left, whichever is the shorter way."""
    left, near = list(range(1, len(centers))), [0]
    while left:
        distances = np.linalg.norm(centers[left] - centers[near[-1]], axis=1)
        near.append(left.pop(int(np.argmin(distances))))
    own = np.arange(len(centers))
    return min((own, np.array(near)), key=lambda order: np.linalg.norm(np.diff(centers[order], axis=0), axis=1).sum())
