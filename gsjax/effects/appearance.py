"""How each photo was taken: the light of its camera, and of photos near it."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from gsjax.effects import vignetting
from gsjax.effects.simulation import Effects, reports
from gsjax.scene import Frame, with_pixels
from gsjax.scene.cameras import Camera, viewmat_center

NEAR_PHOTOS = 3  # that say how one between them is exposed
SAME_PLACE = 1e-6  # squared distance, see `as_near_photos`, below which a photo is where another is


class Appearance(NamedTuple):
    """What one photo makes of light: display-coded values are multiplied by the exponential of this."""

    log_gains: tuple[float, float, float] = (0.0, 0.0, 0.0)
    falloff: tuple[float, float] = (0.0, 0.0)  # see `gsjax.effects.vignetting.falloff`

    def factor(self, frame: Frame) -> np.ndarray:
        """`[H, W, 3]` float32 for the pixels of its frame."""
        camera = Camera(jnp.asarray(frame.viewmat), jnp.asarray(frame.K), frame.width, frame.height)
        falloff = np.asarray(vignetting.falloff(jnp.asarray(self.falloff, jnp.float32), camera))
        return np.exp(falloff[..., None] + np.asarray(self.log_gains, np.float32))


def appearances(reports: Mapping[str, Any]) -> dict[str, Appearance]:
    """Of every photo, by name, by what `gsjax.effects.simulation.reports`. Empty where nothing changes the light."""
    fields = {field: reports[field] for field in Appearance._fields if field in reports}
    names = next(iter(fields.values()), ())
    return {name: Appearance(**{field: tuple(fields[field][name]) for field in fields}) for name in names}


def light_range(effects: Effects, frames: Sequence[Frame]) -> tuple[np.ndarray, np.ndarray]:
    """`[V, 3]` what each photo multiplies display-coded light by, at most and at least, as the effects start."""
    lit = {name: effect for name, effect in effects.items() if effect.light}
    looks = appearances(reports(lit, {name: effect.initial for name, effect in lit.items()}))
    every = [looks.get(frame.name, Appearance()) for frame in frames]
    sizes = np.array([(frame.width, frame.height) for frame in frames])
    centers, focals = (np.array([get(frame.K) for frame in frames]) for get in (lambda K: K[:2, 2], np.diagonal))
    tangents2 = np.square(np.maximum(centers, sizes - centers) / focals[:, :2]).sum(-1)
    corners = np.stack([tangents2, np.square(tangents2)], -1) * np.array([look.falloff for look in every])
    gains = np.array([look.log_gains for look in every])
    return np.exp(gains), np.exp(gains + corners.sum(-1, keepdims=True))


def as_near_photos(frames: Sequence[Frame], looks: Mapping[str, Appearance]) -> dict[str, Appearance]:
    """Of every held-out photo, by name: its own fall-off, and gains as photos have that were taken near it.

    A camera exposes for what it sees, so what was taken from near by, looking the same way, is exposed alike. Means of
    the nearest training photos' gains, by inverse squares of the distance: of the cameras (in mean distances from
    their middle) and of the ends of their optical axes. No pixel of a held-out photo is used, nor a keypoint.
    """
    stood = {frame.name: _position_and_axis(frame) for frame in frames}
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


def _position_and_axis(frame: Frame) -> np.ndarray:
    """`[6]` centre and optical axis of a camera, world, float64."""
    viewmat = frame.viewmat.astype(np.float64)
    return np.concatenate([viewmat_center(viewmat), viewmat[2, :3]])


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
