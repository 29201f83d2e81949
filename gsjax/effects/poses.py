"""Poses that contradict the tracks, and cameras whose poses training corrects."""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from gsjax.effects.camera_twists import apply_twist, gauge
from gsjax.effects.kinds import EffectKind, Evidence, Findings, Rate, StartInputs, unknown
from gsjax.effects.observations import Observations
from gsjax.effects.pose_steps import gauss_newton_steps
from gsjax.effects.simulation import Effect
from gsjax.scene import Frame
from gsjax.scene.cameras import Camera, viewmat_center

THRESHOLD = 0.3  # pixels
SHARE = 0.2  # of the photos must want to move
RATE, RATE_KNOWN = 1e-3, 2.5e-4  # Adam's learning rate, of radians and of units; where tracks have told the start
HOLD, HOLD_SHARE = 1000, 0.3  # steps that cameras wait for Gaussians to be somewhere; of a run at most
LIMIT = 0.3  # of the logarithm of a focal length against the given one


def judge(findings: Findings) -> Evidence:
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


def simulate(inputs: StartInputs, rate: Rate) -> Effect:
    """The effect of a run, from what the tracks imply."""
    frames, names, trained, whose = inputs.observations.frames, inputs.names, inputs.trained, inputs.camera
    centers = np.stack([viewmat_center(frame.viewmat.astype(np.float64)) for frame in frames])
    unit, start_twists = _median_depth(inputs.observations), twists_from_tracks(inputs.observations)
    schedule = rate(peak=RATE_KNOWN if inputs.observations.tracked else RATE, hold=HOLD, share=HOLD_SHARE)
    effect = make_effect(centers[trained], unit, whose[trained], whose.max() + 1, schedule, start_twists[trained])
    return effect._replace(
        report=lambda numbers: {"moves": dict(zip(names, moves(numbers, centers, unit, trained, whose), strict=True))}
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


def _median_depth(observations: Observations) -> float:
    """Of some points in front of the cameras; the spread of the cameras where there are none."""
    points = observations.points[:: max(1, len(observations.points) // 1000)]
    depths = np.concatenate([points @ frame.viewmat[2, :3] + frame.viewmat[2, 3] for frame in observations.frames])
    if (depths > 0).any():
        return float(np.median(depths[depths > 0]))
    centers = np.stack([frame.viewmat[:3, 3] for frame in observations.frames])
    return float(np.linalg.norm(centers - centers.mean(0), axis=1).max()) or 1.0


EFFECT = EffectKind(judge, simulate, on_evidence=True, per_photo=True)
