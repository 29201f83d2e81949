"""How each photo was taken, by tracks and by training: where the effects start, and what became of them."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import optax

from gsjax.effects import background, effect_module, exposure, poses, vignetting
from gsjax.effects.observations import Observations
from gsjax.effects.photo_gains import fit, table
from gsjax.effects.simulation import Effects, EffectState
from gsjax.effects.sky import Masks
from gsjax.scene import Frame, with_pixels
from gsjax.scene.cameras import Camera, viewmat_center
from gsjax.settings import SIMULATED

NEAR_PHOTOS = 3  # that say how one between them is exposed
SAME_PLACE = 1e-6  # squared distance, see `as_near_photos`, below which a photo is where another is


class Appearance(NamedTuple):
    """What one photo makes of light: display-coded values are multiplied by the exponential of this."""

    log_gains: tuple[float, float, float]
    falloff: tuple[float, float]  # see `gsjax.effects.vignetting.falloff`

    def factor(self, frame: Frame) -> np.ndarray:
        """`[H, W, 3]` float32 for the pixels of its frame."""
        camera = Camera(jnp.asarray(frame.viewmat), jnp.asarray(frame.K), frame.width, frame.height)
        falloff = np.asarray(vignetting.falloff(jnp.asarray(self.falloff, jnp.float32), camera))
        return np.exp(falloff[..., None] + np.asarray(self.log_gains, np.float32))


@dataclass(frozen=True)
class Start:
    """What tracks imply of V photos by C cameras, before any training."""

    names: tuple[str, ...]  # of the photos
    trained: np.ndarray  # [V] bool: not held out
    log_gains: np.ndarray  # [V, 3] of display-coded values, mean zero over the photos that are trained on
    camera: np.ndarray  # [V] int32, whose camera
    falloff: np.ndarray  # [C, 2]
    centers: np.ndarray  # [V, 3] float64 of the cameras, world
    distance: float  # scene units: the median depth of the points in all photos
    twists: np.ndarray  # [V, 6] turns (radians) and shifts (scene units) by which tracks correct the cameras
    background: np.ndarray  # [(L + 1)^2, 3] SH coefficients of what is behind all
    tracked: bool  # whether tracks told any of this


def start(observations: Observations, names: Collection[str], skies: Masks = MappingProxyType({})) -> Start:
    """Where the chosen effects start; zero without tracks. `skies` are where photos show sky.

    The same robust fit as the evidence, of display-coded values, since those are what training compares.
    """
    frames = observations.frames
    trained = np.array([not frame.held_out for frame in frames])
    log_gains, slope = np.zeros((len(frames), 3)), 0.0
    data = table(np.log(observations.colors), observations.photo, observations.point, len(frames))
    if len(data.photo):
        solution = fit(data)
        if "vignetting" in names:
            tangents2 = observations.tangents2
            slope = min(vignetting.slope_on(tangents2, data, solution)[0], 0.0)
            solution = fit(data._replace(values=data.values - slope * tangents2[data.rows][:, None]))
        has_gain = np.bincount(data.photo, minlength=len(frames)) > 0
        if (has_gain & trained).any():
            log_gains = np.where(has_gain[:, None], solution.gains - solution.gains[has_gain & trained].mean(0), 0.0)
    cameras = [(frame.width, frame.height, frame.K.tobytes()) for frame in frames]
    distinct = list(dict.fromkeys(cameras))
    falloff = np.tile(np.array([slope, 0.0]), (len(distinct), 1))
    return Start(
        tuple(frame.name for frame in frames),
        trained,
        log_gains.astype(np.float32),
        np.array([distinct.index(camera) for camera in cameras], np.int32),
        falloff.astype(np.float32),
        np.stack([_stands(frame)[:3] for frame in frames]),
        _median_depth(observations),
        poses.twists_from_tracks(observations) if "poses" in names else np.zeros((len(frames), 6)),
        background.initial(observations, skies),
        observations.tracked,
    )


def light_range(start_values: Start, frames: Sequence[Frame], names: Collection[str]) -> tuple[np.ndarray, np.ndarray]:
    """`[V, 3]` what each photo multiplies display-coded light by, at most and at least, as the chosen effects start."""
    gains = start_values.log_gains if "exposure" in names else np.zeros_like(start_values.log_gains)
    sizes = np.array([(frame.width, frame.height) for frame in frames])
    centers, focals = (np.array([get(frame.K) for frame in frames]) for get in (lambda K: K[:2, 2], np.diagonal))
    tangents2 = np.square(np.maximum(centers, sizes - centers) / focals[:, :2]).sum(-1)
    corners = np.stack([tangents2, np.square(tangents2)], -1) * start_values.falloff[start_values.camera]
    return np.exp(gains), np.exp(gains + corners.sum(-1, keepdims=True))


def simulations(start_values: Start, names: Collection[str], rate: Callable[..., optax.Schedule]) -> Effects:
    """The named effects, over the photos that are trained on.

    `rate` is the schedule of the run by `peak`, `hold` and `share`, see `gsjax.effects.simulation.learning_rate`.
    """
    return {name: effect_module(name).simulate(start_values, rate) for name in SIMULATED if name in names}


def appearances(start_values: Start, state: EffectState) -> dict[str, Appearance]:
    """Of every photo, by name, after training: gains as learned, those of held-out photos as their tracks imply.

    No pixel of a held-out photo has been used but its keypoints. Empty where nothing changes the light.
    """
    numbers: dict[str, Any] = state.numbers
    if not {"exposure", "vignetting"} & numbers.keys():
        return {}
    gains = np.zeros_like(start_values.log_gains)
    if "exposure" in numbers:
        gains = start_values.log_gains.copy()
        gains[start_values.trained] = np.asarray(exposure.log_gains(jnp.asarray(numbers["exposure"])))
    falloff = np.asarray(numbers.get("vignetting", np.zeros_like(start_values.falloff)))
    return {
        name: Appearance(tuple(gains[index].tolist()), tuple(falloff[start_values.camera[index]].tolist()))
        for index, name in enumerate(start_values.names)
    }


def as_near_photos(frames: Sequence[Frame], looks: Mapping[str, Appearance]) -> dict[str, Appearance]:
    """Of every held-out photo, by name: its own fall-off, and gains as photos have that were taken near it.

    A camera exposes for what it sees, so what was taken from near by, looking the same way, is exposed alike. Means of
    the nearest training photos' gains, by inverse squares of the distance: of the cameras (in mean distances from
    their middle) and of the ends of their optical axes. No pixel of a held-out photo is used, nor a keypoint.
    """
    stood = {frame.name: _stands(frame) for frame in frames}
    trained = [frame.name for frame in frames if not frame.held_out]
    places = np.stack([stood[name] for name in trained]) if trained else np.zeros((0, 6))
    spread = float(np.linalg.norm(places[:, :3] - places[:, :3].mean(0), axis=1).mean()) or 1.0
    scale = np.array([spread] * 3 + [1.0] * 3)
    gains = np.array([looks[name].log_gains for name in trained])
    of_photos = {}
    for frame in frames:
        if frame.held_out:
            apart2 = np.square((places - stood[frame.name]) / scale).sum(-1)
            nearest = np.argsort(apart2)[:NEAR_PHOTOS]
            weights = 1 / (apart2[nearest] + SAME_PLACE)
            mean = weights @ gains[nearest] / weights.sum()
            of_photos[frame.name] = looks[frame.name]._replace(log_gains=tuple(mean.tolist()))
    return of_photos


def _stands(frame: Frame) -> np.ndarray:
    """`[6]` centre and optical axis of a camera, world, float64."""
    viewmat = frame.viewmat.astype(np.float64)
    return np.concatenate([viewmat_center(viewmat), viewmat[2, :3]])


def moves(start_values: Start, state: EffectState) -> dict[str, poses.Move]:
    """Of every photo's camera, by name, after training; empty where they stayed."""
    if "poses" not in state.numbers:
        return {}
    matrices = poses.moves(
        state.numbers["poses"], start_values.centers, start_values.distance, start_values.trained, start_values.camera
    )
    return dict(zip(start_values.names, matrices, strict=True))


def fit_colors(colors: np.ndarray, image: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """`[H, W, 3]` colours after the affine map that makes them nearest to an image's over the valid pixels."""
    ones = np.ones((*colors.shape[:2], 1))
    basis = np.concatenate([colors, ones], axis=-1, dtype=np.float64)
    if not valid.any():
        return colors
    weights = np.linalg.lstsq(basis[valid], image[valid].astype(np.float64), rcond=None)[0]
    return (basis @ weights).astype(np.float32)


def without_appearance(frame: Frame, look: Appearance) -> Frame:
    """The frame with its photo divided by what its camera did, in memory: as the mean photo would show it.

    Pixels that this makes brighter than white are clipped, as the photo would have.
    """
    pixels = frame.pixels()
    image = np.clip(np.rint(pixels.image / look.factor(frame)), 0, 255).astype(np.uint8)
    return with_pixels(frame, pixels._replace(image=image))


def _median_depth(observations: Observations) -> float:
    """Of some points in front of the cameras; the spread of the cameras where there are none."""
    points = observations.points[:: max(1, len(observations.points) // 1000)]
    depths = np.concatenate([points @ frame.viewmat[2, :3] + frame.viewmat[2, 3] for frame in observations.frames])
    if (depths > 0).any():
        return float(np.median(depths[depths > 0]))
    centers = np.stack([frame.viewmat[:3, 3] for frame in observations.frames])
    return float(np.linalg.norm(centers - centers.mean(0), axis=1).max()) or 1.0
