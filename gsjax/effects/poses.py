"""Poses that contradict the tracks, and cameras whose poses training corrects."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from gsjax.effects.camera_twists import apply_twist, gauge
from gsjax.effects.evidence import Evidence, unknown
from gsjax.effects.observations import Observations
from gsjax.effects.simulation import Effect
from gsjax.scene import Frame
from gsjax.scene.cameras import Camera

if TYPE_CHECKING:
    from gsjax.effects.appearance import Start
    from gsjax.effects.diagnosis import Findings

THRESHOLD = 0.3  # pixels
SIGNIFICANT = 3  # standard errors
SHARE = 0.2  # of the photos must want to move
FEWEST = 8  # observations of a photo
RATE, RATE_KNOWN = 1e-3, 2.5e-4  # Adam's learning rate, of radians and of units; where tracks have told the start
HOLD, HOLD_SHARE = 1000, 0.3  # steps that cameras wait for Gaussians to be somewhere; of a run at most
LIMIT = 0.3  # of the logarithm of a focal length against the given one
_ROUNDS, _OUTLIER = 5, 1.5  # of reweighting; standard deviations that count in full (Huber)


class Step(NamedTuple):
    """A Gauss-Newton step of one photo's pose."""

    shift: float  # median shift of its points in the picture, pixels
    error: float  # standard error of that
    turn: np.ndarray  # [3] of the camera about its centre, along the world's axes, radians
    move: np.ndarray  # [3] of its centre, scene units

    @property
    def is_sure(self) -> bool:
        """Whether it is more than its own error."""
        return self.shift > SIGNIFICANT * self.error


def gauss_newton_steps(observations: Observations) -> tuple[Step | None, ...]:
    """The robust Gauss-Newton step of every photo on its reprojection errors, points fixed; None of too few points."""
    return tuple(_step(observations, index) for index in range(len(observations.frames)))


def judge(findings: "Findings") -> Evidence:
    """On where a fifth of the photos would move their points significantly, by more than a third of a pixel."""
    steps = [step for step in findings.steps if step is not None]
    if not steps:
        return unknown("px", THRESHOLD, "needs keypoints matched in the photos")
    value = float(np.quantile([step.shift for step in steps], 1 - SHARE))
    sure = np.mean([step.is_sure and step.shift > THRESHOLD for step in steps])
    noise = float(np.median([step.error for step in steps]))
    note = f"the step that {100 * SHARE:.0f} % of the photos exceed, against their tracks"
    note += "; poses and points that are wrong together do not show"
    return Evidence(bool(sure >= SHARE), value, "px", noise, THRESHOLD, note)


class Move(NamedTuple):
    """What training made of one photo's camera."""

    turn: tuple[float, float, float]  # about its centre: a rotation vector along the world's axes, radians
    shift: tuple[float, float, float]  # of its centre, scene units
    focal: float  # factor of both focal lengths

    def apply(self, frame: Frame) -> Frame:
        """The frame as taken by the camera so moved."""
        original = Camera(jnp.asarray(frame.viewmat), jnp.asarray(frame.K), frame.width, frame.height)
        camera = _moved_and_zoomed(
            original, jnp.asarray([*self.turn, *self.shift], jnp.float32), jnp.float32(self.focal)
        )
        return replace(frame, viewmat=np.asarray(camera.viewmat), K=np.asarray(camera.K))


def twists_from_tracks(observations: Observations) -> np.ndarray:
    """`[V, 6]` turns (radians) and shifts (scene units) of cameras that tracks imply; zero where not significant."""
    photo_twists = np.zeros((len(observations.frames), 6))
    for index, step in enumerate(gauss_newton_steps(observations)):
        if step is not None and step.is_sure:
            photo_twists[index] = *step.turn, *step.move
    return photo_twists


def simulate(start_values: "Start", rate: Callable[..., optax.Schedule]) -> Effect:
    """The effect of a run: where it starts, and its schedule by `peak`, `hold`, `share` and `final`."""
    return make_effect(
        start_values.centers[start_values.trained],
        start_values.distance,
        start_values.camera[start_values.trained],
        len(start_values.falloff),
        rate(peak=RATE_KNOWN if start_values.tracked else RATE, hold=HOLD, share=HOLD_SHARE),
        start_values.twists[start_values.trained],
    )


def make_effect(
    centers: np.ndarray,
    unit: float,
    whose: np.ndarray,
    count: int,
    rate: optax.Schedule,
    initial: np.ndarray | None = None,
) -> Effect:
    """Every photo's camera is moved by its own twist, and every camera's focal length by a factor of 1 at the start.

    What moves all cameras together with the world changes no photo: it is taken off the twists as they are used
    (`gauge`), so the scene stays where the data set has it whatever an optimiser does. A common factor of all focal
    lengths shows in the photos, and stays.

    Args:
        centers: `[V, 3]` camera centres, world.
        unit: Scene units of a shift of 1: about the distance to what is seen, so turns and shifts move pixels alike.
        whose: `[V]` whose camera took which photo, 0..C-1.
        count: C, of the cameras.
        rate: See `Effect`.
        initial: `[V, 6]` turns, radians, and shifts, scene units, to start with. None: none.
    """
    fixed, whose = gauge(centers, unit), np.asarray(whose, np.int32)
    start_twists = np.zeros((len(centers), 6)) if initial is None else initial / np.repeat([1.0, unit], 3)
    start_numbers = {"twists": start_twists.astype(np.float32), "log_focals": np.zeros(count, np.float32)}

    def camera(numbers: Any, original: Camera, photo: Array) -> Camera:
        focal = jnp.exp(log_focals(numbers)[jnp.asarray(whose)[photo]])
        return zoom_camera(apply_twist(original, twists(numbers, fixed)[photo], unit), focal)

    return Effect(start_numbers, rate, camera=camera)


def twists(numbers: Any, fixed: np.ndarray) -> Array:
    """`[V, 6]` of the numbers that are optimised, without their part in the orthonormal `fixed` `[6 V, G]`."""
    free = numbers["twists"].reshape(-1)
    common = jnp.matmul(free, fixed, precision=jax.lax.Precision.HIGHEST)
    return (free - jnp.matmul(fixed, common, precision=jax.lax.Precision.HIGHEST)).reshape(-1, 6)


def log_focals(numbers: Any) -> Array:
    """`[C]` logarithms of the factors of the focal lengths."""
    return jnp.clip(numbers["log_focals"], -LIMIT, LIMIT)


def zoom_camera(camera: Camera, focal: Array) -> Camera:
    """The camera with both focal lengths times `focal`."""
    factors = jnp.stack([focal, focal, jnp.ones_like(focal)])
    scaled = camera.K * jnp.where(jnp.eye(3, dtype=bool), factors[:, None], 1)
    return Camera(camera.viewmat, scaled, camera.width, camera.height)


@jax.jit
def _moved_and_zoomed(camera: Camera, twist: Array, focal: Array) -> Camera:
    return zoom_camera(apply_twist(camera, twist, 1.0), focal)


def moves(numbers: Any, centers: np.ndarray, unit: float, trained: np.ndarray, whose: np.ndarray) -> tuple[Move, ...]:
    """Of all V photos after training. Those that are held out keep their pose, and share their camera's focal length.

    `numbers` are of the photos that are trained on (`trained` `[V]` bool), the rest as in `make_effect`.
    """
    photo_twists = np.zeros((len(centers), 6))
    photo_twists[trained] = np.asarray(twists(numbers, gauge(centers[trained], unit))) * np.repeat([1.0, unit], 3)
    focals = np.exp(np.asarray(log_focals(numbers), np.float64))
    rows = zip(photo_twists.tolist(), focals[whose].tolist(), strict=True)
    return tuple(Move(tuple(twist[:3]), tuple(twist[3:]), focal) for twist, focal in rows)


def _step(observations: Observations, index: int) -> Step | None:
    rows = observations.photo == index
    if rows.sum() < FEWEST:
        return None
    frame = observations.frames[index]
    viewmat, K = frame.viewmat.astype(np.float64), frame.K.astype(np.float64)
    local = observations.points[observations.point[rows]] @ viewmat[:3, :3].T + viewmat[:3, 3]
    front = local[:, 2] > 1e-6
    if front.sum() < FEWEST:
        return None
    local, observed = local[front], observations.pixels[rows][front]
    x, y, z = local.T
    focal = K[[0, 1], [0, 1]]
    errors = observed - (local[:, :2] / z[:, None] * focal + K[:2, 2])
    zero, one = np.zeros_like(x), np.ones_like(x)
    # Of a turn about the camera's axes (radians), then of a move in units of depth.
    depth = float(np.median(z))
    across = np.stack([-x * y / z**2, 1 + (x / z) ** 2, -y / z, one * depth / z, zero, -x / z**2 * depth], -1)
    down = np.stack([-(1 + (y / z) ** 2), x * y / z**2, x / z, zero, one * depth / z, -y / z**2 * depth], -1)
    slopes = np.stack([across, down], axis=1) * focal[:, None]  # [M, 2, 6]
    weights, twist, inverse, sigma = np.ones(len(x)), np.zeros(6), np.eye(6), 0.0
    for _ in range(_ROUNDS):
        normal = np.einsum("mca,mcb,m->ab", slopes, slopes, weights)
        inverse = np.linalg.inv(normal + 1e-9 * np.trace(normal) * np.eye(6))
        twist = inverse @ np.einsum("mca,mc,m->a", slopes, errors, weights)
        left = np.linalg.norm(errors - slopes @ twist, axis=1)
        sigma = float(np.median(left)) / 1.1774  # of one coordinate, were both normal
        weights = np.minimum(1.0, _OUTLIER * sigma / np.maximum(left, 1e-12))
    shift = float(np.median(np.linalg.norm(slopes @ twist, axis=1)))
    # Points that turn before a camera are a camera that turns the other way.
    turn, move = -viewmat[:3, :3].T @ twist[:3], -depth * viewmat[:3, :3].T @ twist[3:]
    variances = np.einsum("mca,ab,mcb->m", slopes, inverse, slopes) * sigma**2
    return Step(shift, float(np.sqrt(np.median(variances))), turn, move)
