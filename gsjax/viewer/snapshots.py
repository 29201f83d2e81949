"""Gaussians of a running training, copied on request."""

import time
from collections.abc import Callable
from threading import Event

import jax
import jax.numpy as jnp
import numpy as np

from gsjax.training.loop import Progress
from gsjax.viewer.page import News

EVERY = 5.0  # Seconds between two snapshots, at least.


class Snapshots:
    """Hands Gaussians of a training, which reports every step, to the page, which requests them now and then.

    A step without a request costs one test of a flag.
    """

    def __init__(self, steps: int, *, every: float = EVERY, clock: Callable[[], float] = time.monotonic):
        """Of a training of so many steps."""
        self._steps, self._every, self._clock = steps, every, clock
        self._asked, self._taken, self._asked_at = Event(), None, -float("inf")

    def observe(self, progress: Progress) -> None:
        """Receive the report of a step, in the training's own thread."""
        if self._asked.is_set():
            self._asked.clear()
            # The next step takes the buffers.
            gaussians = jax.tree.map(jnp.copy, progress.state.gaussians)
            effects = progress.state.effects
            background = None if effects is None else effects.numbers.get("background")
            self._taken = News(
                gaussians,
                f"{progress.phase.name}: step {progress.step:,} of {self._steps:,}",
                None if background is None else np.array(background),
            )

    def news(self) -> News | None:
        """What was copied since the last call, if anything; requests the next where it is time."""
        news, self._taken = self._taken, None
        if self._clock() - self._asked_at >= self._every and not self._asked.is_set():
            self._asked_at = self._clock()
            self._asked.set()
        return news
