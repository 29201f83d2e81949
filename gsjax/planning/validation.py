"""Short validation runs on small photos: whether a change to a run improves pixels that the run was not trained on."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from gsjax.config import parse
from gsjax.effects import transients
from gsjax.effects.simulation import NO_EFFECTS, Effects
from gsjax.metrics.images import in_decibels
from gsjax.presets import QUICK
from gsjax.scene import Frame
from gsjax.settings import Settings, Supervision
from gsjax.training.loop import Progress, Work, follow
from gsjax.training.optimizers import Optimizer
from gsjax.training.plan import Plan
from gsjax.training.state import TrainState
from gsjax.training.step import TrainStep, kept_step, make_train_step

STEPS = 200  # of a validation run with densification
SIDE = 160  # pixels of the longest photo, about
PER_PIXEL, PER_POINT = 0.6, 4  # Gaussians, by pixel of a photo and by matched point; no more than the run's
WORTH = 0.1  # dB that a change must gain
SHORT = parse(  # `quick` in so many steps
    Settings,
    {
        "schedule": {"phases": [{"name": "validation", "steps": STEPS, "density_control": True}], "sh_every": 33},
        "rates": QUICK["rates"],
        "density": {**QUICK["density"], "start": 7, "stop": 140, "every": 20},
    },
)

Observe = Callable[[], object]
"""Called after every step."""


def image_scale(frames: Sequence[Frame], side: int = SIDE) -> int:
    """Factor by which validation runs reduce photos, to about so many pixels of the longest side."""
    return max(1, round(max(max(frame.width, frame.height) for frame in frames) / side))


def short_settings(settings: Settings, frames: Sequence[Frame], points: int, side: int = SIDE) -> Settings:
    """The settings of a validation run: `quick` in few steps on small photos, with the run's seed and background.

    `points` is the number of matched points; `side` is that of the longest photo, pixels, about.
    """
    scale = image_scale(frames, side)
    pixels = max(frame.width * frame.height for frame in frames) / scale**2
    return settings.replace(
        rates=SHORT.rates,
        density=SHORT.density,
        schedule={
            "phases": (replace(SHORT.schedule.phases[0], image_scale=scale),),
            "sh_every": SHORT.schedule.sh_every,
        },
        model={"max_gaussians": min(max(round(PER_PIXEL * pixels), PER_POINT * points), settings.model.max_gaussians)},
        supervision=Supervision(),
    )


class Variant:
    """One way to train. All its validation runs share their buffers and their compiled programs."""

    def __init__(self, plan: Plan, optimizer: Optimizer, extent: float, effects: Effects = NO_EFFECTS):
        """Before the first run. The fields mean what those of `gsjax.training.loop.Work` do."""
        self.plan, self.optimizer, self.effects = plan, optimizer, effects
        self._extent = extent
        self._capacity: int | None = None  # of the pair buffer, as the last run left it
        self._make_step = _kept_steps(effects) if effects else kept_step  # which keeps such steps for all variants

    def train(self, frames: Sequence[Frame], state: TrainState, observe: Observe) -> TrainState:
        """The state after all steps. The buffers of the given one are taken."""

        def note(progress: Progress) -> None:
            self._capacity = progress.capacity
            observe()

        work = Work(
            self.plan,
            frames,
            self._extent,
            self.optimizer,
            observe=note,
            effects=self.effects,
            make_step=self._make_step,
        )
        return follow(work, state, self._capacity)


def _kept_steps(effects: Effects) -> Callable[..., TrainStep]:
    """`make_train_step` with these effects, the same step for the same arguments."""
    make_cached = cache(partial(make_train_step, effects=effects))

    def make(*args: Any, effects: Effects, **options: Any) -> TrainStep:
        return make_cached(*args, **options)

    return make


def mean_and_error(values: Sequence[float]) -> tuple[float, float]:
    """Mean of two values at least, and its standard error."""
    return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values)))


class ValidationGain(NamedTuple):
    """The gain of a change in validation runs."""

    gain: float  # dB on held-out pixels, with the change less without, mean over the photos
    error: float  # its standard error

    @property
    def passes(self) -> bool:
        """Whether the change is worth making."""
        return self.gain >= WORTH and self.gain > self.error

    def __str__(self):
        return f"{self.gain:+.2f} +-{self.error:.2f} dB"


def compared(
    without: Sequence[np.ndarray],
    with_change: Sequence[np.ndarray],
    photos: Sequence[np.ndarray],
    valid: Sequence[np.ndarray],
    held_out: Sequence[np.ndarray],
) -> ValidationGain:
    """PSNR on the held-out pixels, one variant less the other, by a score that both share; 0 of fewer than two photos.

    Both are multiplied by one factor per channel, of all photos together, that fits the pixels which are not held out:
    a few steps do not reach the scene's brightness, and an effect that darkens all photos would seem right. A pixel
    that both miss by far is left out of both scores: it shows what no other photo shows.

    All are of one photo each: `[H, W, 3]` pictures without the change and with it, and photos; `[H, W]` bool of pixels
    that are `valid`, and of those that are scored (`held_out`).
    """
    fit_pixels = [usable & ~out for usable, out in zip(valid, held_out, strict=True)]
    scored = [usable & out for usable, out in zip(valid, held_out, strict=True)]
    both = [_errors(pictures, photos, fit_pixels) for pictures in (without, with_change)]
    least = [np.minimum(*pair) for pair in zip(*both, strict=True)]
    pooled = np.concatenate([error[pixels] for error, pixels in zip(least, scored, strict=True)])
    most = transients.REACH**2 * np.quantile(pooled, transients.QUANTILE) if len(pooled) else 0.0
    gains = []
    for before, after, error, pixels in zip(*both, least, scored, strict=True):
        counted = pixels & (error <= most)
        if counted.any():
            gains.append(float(in_decibels(after[counted].mean()) - in_decibels(before[counted].mean())))
    return ValidationGain(*mean_and_error(gains)) if len(gains) > 1 else ValidationGain(0.0, 0.0)


def _errors(
    pictures: Sequence[np.ndarray], photos: Sequence[np.ndarray], fit_pixels: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """`[H, W]` mean squared differences of the channels, after one factor per channel that fits some pixels."""
    triples = list(zip(pictures, photos, fit_pixels, strict=True))
    products = np.sum([(picture[there] * photo[there]).sum(0) for picture, photo, there in triples], axis=0)
    squares = np.sum([np.square(picture[there]).sum(0) for picture, _, there in triples], axis=0)
    factor = np.where(squares > 0, products / np.where(squares > 0, squares, 1), 1)
    return [np.square(np.clip(picture * factor, 0, 1) - photo).mean(-1) for picture, photo, _ in triples]
