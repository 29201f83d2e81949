"""Validation runs of effects: small photos that lack large blocks of pixels, and pictures of them afterwards."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from gsjax.effects.kinds import simulations
from gsjax.effects.observations import Observations
from gsjax.effects.simulation import HOLD, RATE, Effect, Effects, light_behind, light_in_photo, move_camera
from gsjax.planning.validation import Observe, ValidationGain, Variant, compared
from gsjax.rendering import gallery
from gsjax.runs.result import BACKGROUND_COLORS
from gsjax.scene import Frame, batches, with_pixels
from gsjax.scene.batches import Batch
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
        variant, on = self._variant, simulations(self.observations, names, _rate)
        state = self.initial(self.settings, variant.optimizer, variant.effects)
        if state.effects is not None:
            numbers = {
                name: (jnp.float32(name in on), jax.tree.map(jnp.asarray, on.get(name, off).initial))
                for name, off in self._effects.items()
            }
            state = replace(state, effects=replace(state.effects, numbers=numbers))
        training_frames = [
            _without_pixels(frame, blocks) for frame, blocks in zip(self.frames, self.held_out, strict=True)
        ]
        return self._pictures(variant.train(training_frames, state, observe))

    def compare(self, without: Sequence[np.ndarray], with_effect: Sequence[np.ndarray]) -> ValidationGain:
        """The gain of an effect on the held-out pixels, from the pictures of both variants."""
        photos = [np.asarray(photo.image)[part] for photo, part in self._photos]
        valid = [np.asarray(photo.valid)[part] for photo, part in self._photos]
        middles = slice(self._scale // 2, None, self._scale)
        held_out = [
            blocks[middles, middles][part] for blocks, (_, part) in zip(self.held_out, self._photos, strict=True)
        ]
        return compared(without, with_effect, photos, valid, held_out)

    @cached_property
    def _effects(self) -> Effects:
        return simulations(self.observations, self.proposed, _rate)

    @cached_property
    def _variant(self) -> Variant:
        """A validation run that simulates any of the proposed effects, each with a switch."""
        planned = plan(self.settings).with_effects(self.proposed)
        # Points have the colours of the photos that they were matched in: what gains change must be learned in time.
        optimizer = optimizers.make_optimizer(planned.rates, self.extent, planned.steps, color_rate=HURRY * COLOR_RATE)
        effects = {name: switchable(effect, self._color) for name, effect in self._effects.items()}
        return Variant(planned, optimizer, self.extent, effects)

    @cached_property
    def _photos(self) -> list[tuple[Batch, tuple[slice, slice]]]:
        """The photos, reduced, and the part of each that is not padding."""
        data = batches.with_photo_numbers(batches.read_batches(self.frames, scale=self._scale))
        color = jnp.asarray(self._color)
        return [(batches.decode(view, color), np.s_[: view.size[1], : view.size[0]]) for view in data.views]

    @property
    def _scale(self) -> int:
        return self.settings.schedule.phases[0].image_scale

    @property
    def _color(self) -> np.ndarray:
        return BACKGROUND_COLORS[self.settings.model.background]

    def _pictures(self, state: TrainState) -> list[np.ndarray]:
        effects, numbers = self._variant.effects, state.effects and state.effects.numbers
        cameras = [move_camera(effects, numbers, photo.camera, photo.photo) for photo, _ in self._photos]
        black = np.zeros(3, np.float32)
        rendered = gallery.pictures(state.gaussians, cameras, black, self.settings.model.depth_mode)
        pictures = []
        for (photo, part), camera, picture in zip(self._photos, cameras, rendered, strict=True):
            uncovered = (1 - picture.alphas)[..., None]
            behind = np.asarray(light_behind(effects, numbers, camera, jnp.asarray(self._color)))
            # The colour under a matte stays as it is.
            laid = np.float32(0) if photo.matte is None else uncovered * self._color
            colors = np.clip(picture.colors + uncovered * behind, 0, 1) - laid
            pictures.append((np.asarray(light_in_photo(effects, numbers, colors, photo)) + laid)[part])
        return pictures


def switchable(effect: Effect, color: np.ndarray) -> Effect:
    """The effect with a switch before its numbers, 0 or 1: one program trains with it and without.

    Off, it changes nothing and learns nothing; behind all Gaussians is the `color` `[3]` of the run.
    """

    def switched(function: Callable[..., Any] | None, off: Callable[..., Any]) -> Callable[..., Any] | None:
        return function and (lambda numbers, *args: _where(numbers[0], function(numbers[1], *args), off(*args)))

    return Effect(
        (np.float32(0), effect.initial),
        effect.rate,
        camera=switched(effect.camera, lambda original, photo: original),
        behind=switched(effect.behind, lambda view: jnp.asarray(color)),
        light=switched(effect.light, lambda colors, batch: colors),
        trusts=switched(effect.trusts, lambda colors, batch: (np.ones(colors.shape[:2], bool), np.float32(0))),
    )


def _where(switch: Array, on: Any, off: Any) -> Any:
    def choose(a: Array, b: Array) -> Array:
        return jnp.where(jax.lax.stop_gradient(switch) > 0, a, jnp.broadcast_to(b, a.shape))

    return jax.tree.map(choose, on, off)


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
        **{name: getattr(observations, name)[stays] for name in ("photo", "point", "pixels", "colors")},
    )


def _without_pixels(frame: Frame, blocks: np.ndarray) -> Frame:
    pixels = frame.pixels()
    whole = np.full(blocks.shape, 255, np.uint8) if pixels.valid is None else pixels.valid
    return with_pixels(frame, pixels._replace(valid=np.where(blocks, np.uint8(0), whole)))
