"""Validation runs of effects: small photos that lack large blocks of pixels, and pictures of them afterwards."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from gsjax.effects.appearance import Start, appearances, moves, simulations, start
from gsjax.effects.observations import Observations
from gsjax.effects.simulation import HOLD, RATE, Effect, Effects, EffectState
from gsjax.gaussians import Gaussians
from gsjax.planning.validation import Observe, ValidationGain, Variant, compared
from gsjax.rendering import backdrop, gallery
from gsjax.runs.result import BACKGROUND_COLORS
from gsjax.scene import Frame, batches, with_pixels
from gsjax.scene.cameras import Camera
from gsjax.settings import COLOR_RATE, Settings
from gsjax.training import optimizers
from gsjax.training.optimizers import Optimizer
from gsjax.training.plan import plan
from gsjax.training.state import TrainState

HURRY = 10  # times a run's learning rate: of colours and effects, as there are few steps
ACROSS, EVERY = 4, 4  # blocks across the longer side of a photo; one in so many is held out

Initial = Callable[[Settings, Optimizer, Effects], TrainState]
"""(validation run, optimiser, effects) -> step 0 from the run's points."""


@dataclass(frozen=True)
class EffectRuns:
    """What all validation runs of a scene's effects share."""

    settings: Settings  # of a validation run, of one phase
    extent: float  # camera extent, scene units
    initial: Initial
    proposed: Sequence[str]
    observations: Observations  # of these frames, outside of their held-out pixels
    frames: Sequence[Frame]
    held_out: Sequence[np.ndarray]  # [H, W] bool a frame

    def predict(self, names: Sequence[str], *, observe: Observe) -> list[np.ndarray]:
        """`[H, W, 3]` pictures of all frames after a run that simulates the named effects, as their cameras took them.

        The run has the photometric loss alone and no densification.
        """
        variant = self._variant
        start_values = start(self.observations, names)
        on = simulations(start_values, names, _rate)
        state = self.initial(self.settings, variant.optimizer, variant.effects)
        if state.effects is not None:
            numbers = {name: self._numbers(name, each, on) for name, each in variant.effects.items()}
            state = replace(state, effects=replace(state.effects, numbers=numbers))
        training_frames = [
            _without_pixels(frame, blocks) for frame, blocks in zip(self.frames, self.held_out, strict=True)
        ]
        state = variant.train(training_frames, state, observe)
        return self._pictures(state, start_values, names)

    def compare(self, without: Sequence[np.ndarray], with_effect: Sequence[np.ndarray]) -> ValidationGain:
        """The gain of an effect on the held-out pixels, from the pictures of both variants."""
        data = batches.read_batches(self.frames, scale=self._scale)
        photos, valid, held_out = [], [], []
        for target, blocks in zip(data.views, self.held_out, strict=True):
            width, height = target.size
            batch = batches.decode(target, jnp.asarray(self._color))
            photos.append(np.asarray(batch.image)[:height, :width])
            valid.append(np.asarray(batch.valid)[:height, :width])
            middle = self._scale // 2
            held_out.append(blocks[middle :: self._scale, middle :: self._scale][:height, :width])
        return compared(without, with_effect, photos, valid, held_out)

    @cached_property
    def _variant(self) -> Variant:
        """A validation run that simulates any of the proposed effects, each with a switch."""
        planned = plan(self.settings).with_effects(self.proposed)
        # Points have the colours of the photos that they were matched in: what gains change must be learned in time.
        optimizer = optimizers.make_optimizer(planned.rates, self.extent, planned.steps, color_rate=HURRY * COLOR_RATE)
        effects = simulations(start(self.observations, self.proposed), self.proposed, _rate)
        effects = {name: switchable(effect) for name, effect in effects.items()}
        return Variant(planned, optimizer, self.extent, effects)

    def _numbers(self, name: str, effect: Effect, on: Effects) -> tuple[Array, Any]:
        """The numbers of an effect at step 0, its switch before them; a background that is off has the run's colour."""
        value = on[name].initial if name in on else effect.initial[1]
        if name == "background" and name not in on:
            value = backdrop.constant_coefficients(self._color, math.isqrt(len(value)) - 1)
        return jnp.float32(name in on), jax.tree.map(jnp.asarray, value)

    @property
    def _scale(self) -> int:
        return self.settings.schedule.phases[0].image_scale

    @property
    def _color(self) -> np.ndarray:
        return BACKGROUND_COLORS[self.settings.model.background]

    def _pictures(self, state: TrainState, start_values: Start, names: Sequence[str]) -> list[np.ndarray]:
        looks, moved, behind = {}, {}, self._color
        if state.effects is not None:
            numbers = {name: value for name, (_, value) in state.effects.numbers.items() if name in names}
            on = EffectState(numbers, {})
            looks, moved = appearances(start_values, on), moves(start_values, on)
            behind = np.asarray(numbers.get("background", behind))
        frames = [moved[frame.name].apply(frame) if frame.name in moved else frame for frame in self.frames]
        small = [_reduced(frame, self._scale) for frame in frames]
        cameras = [Camera(frame.viewmat, frame.K, frame.width, frame.height) for frame in small]
        gaussians: Gaussians = jax.tree.map(jnp.asarray, state.gaussians)
        pictures = gallery.pictures(gaussians, cameras, behind, self.settings.model.depth_mode)
        return [self._as_taken(frame, picture, looks) for frame, picture in zip(small, pictures, strict=True)]

    def _as_taken(self, frame: Frame, picture: gallery.Picture, looks) -> np.ndarray:
        """What a photo's camera makes of a picture; the colour under a matte stays as it is."""
        if frame.name not in looks:
            return picture.colors
        under = np.float32(0)
        if frame.pixels().matte is not None:
            under = (1 - picture.alphas)[..., None] * self._color
        return (picture.colors - under) * looks[frame.name].factor(frame) + under


def switchable(effect: Effect) -> Effect:
    """The effect with a switch before its numbers, 0 or 1: one program trains with it and without.

    Off, it changes nothing but the light behind all, which is that of its numbers, and learns nothing.
    """

    def camera(numbers, original: Camera, photo: Array) -> Camera:
        assert effect.camera is not None
        return _where(numbers[0], effect.camera(numbers[1], original, photo), original)

    def behind(numbers, view: Camera) -> Array:
        assert effect.behind is not None
        return effect.behind(_where(numbers[0], numbers[1], jax.lax.stop_gradient(numbers[1])), view)

    def light(numbers, colors: Array, batch: batches.Batch) -> Array:
        assert effect.light is not None
        return _where(numbers[0], effect.light(numbers[1], colors, batch), colors)

    def trusts(numbers, colors: Array, batch: batches.Batch) -> tuple[Array, Array]:
        assert effect.trusts is not None
        trusted, added = effect.trusts(numbers[1], colors, batch)
        return _where(numbers[0], (trusted, added), (jnp.ones_like(trusted), jnp.zeros_like(added)))

    return Effect(
        (np.float32(0), effect.initial),
        effect.rate,
        camera=effect.camera and camera,
        behind=effect.behind and behind,
        light=effect.light and light,
        trusts=effect.trusts and trusts,
    )


def _where(switch: Array, on, off):
    return jax.tree.map(lambda a, b: jnp.where(jax.lax.stop_gradient(switch) > 0, a, b), on, off)


def _rate(peak: float = RATE, hold: int = HOLD, **_: Any) -> optax.Schedule:
    """Of so few steps. What a run holds at first stays where the tracks put it: a scene that is blurred misleads."""
    return optax.constant_schedule(0.0 if hold else HURRY * peak)


def held_out_blocks(frame: Frame, index: int) -> np.ndarray:
    """`[H, W]` bool: a quarter of a photo's pixels in large blocks, others in each of four consecutive photos."""
    side = -(-max(frame.width, frame.height) // ACROSS)
    row, column = np.arange(frame.height)[:, None] // side, np.arange(frame.width)[None] // side
    return (column + 2 * row + index) % EVERY == 0


def without_blocks(observations: Observations, frames: Sequence[Frame], held_out: Sequence[np.ndarray]) -> Observations:
    """The observations of some frames alone, outside of their held-out pixels; the other frames count as held out."""
    blocks = dict(zip((frame.name for frame in frames), held_out, strict=True))
    stays = np.zeros(len(observations.photo), bool)
    for index, frame in enumerate(observations.frames):
        rows = np.flatnonzero(observations.photo == index)
        if frame.name in blocks and len(rows):
            column, row = np.floor(observations.pixels[rows]).astype(int).T
            row, column = np.clip(row, 0, frame.height - 1), np.clip(column, 0, frame.width - 1)
            stays[rows] = ~blocks[frame.name][row, column]
    return replace(
        observations,
        frames=tuple(replace(frame, held_out=frame.name not in blocks) for frame in observations.frames),
        photo=observations.photo[stays],
        point=observations.point[stays],
        pixels=observations.pixels[stays],
        colors=observations.colors[stays],
    )


def _without_pixels(frame: Frame, blocks: np.ndarray) -> Frame:
    pixels = frame.pixels()
    whole = np.full(blocks.shape, 255, np.uint8) if pixels.valid is None else pixels.valid
    return with_pixels(frame, pixels._replace(valid=np.where(blocks, np.uint8(0), whole)))


def _reduced(frame: Frame, scale: int) -> Frame:
    """The camera of a photo reduced by a factor."""
    K = (np.diag([1 / scale, 1 / scale, 1]) @ frame.K).astype(np.float32)
    return replace(frame, K=K, width=frame.width // scale, height=frame.height // scale)
