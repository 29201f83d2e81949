"""What a scene says about one effect: a statistic, how far it can be trusted, what follows, and what it would cost."""

import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from gsjax.scene import Frame

GAUSSIANS = 100_000  # that a cost by the Gaussian is told for
_TIMED, _TIMES = 1_000_000, 5  # values, and how often they are gone over
_DEARER = 20  # A pass in a compiled step takes so many times as long (docs/effects.md, experiments/benchmarks).


class Cost(NamedTuple):
    """Of simulating an effect, from counts."""

    values: float = 0.0  # numbers that a step goes over once more, forward and back
    bytes: int = 0  # of its numbers, moments included
    note: str = ""

    def record(self, pace: float) -> dict[str, float | int | str]:
        """Plain values for a file, at so many seconds a value."""
        return {"ms": round(1e3 * pace * self.values, 3), "bytes": self.bytes, "note": self.note}


class Evidence(NamedTuple):
    """The report line of an effect."""

    on: bool  # the scene calls for it
    value: float | None  # larger speaks more for the effect; None: the scene has no means to judge
    unit: str
    noise: float | None  # what `value` may be off by, or what it is where the effect is absent
    threshold: float  # `on` needs a larger value
    cost: Cost
    note: str

    def record(self, pace: float) -> dict[str, Any]:
        """Plain values for a file, costs at so many seconds a value; the statistic is called evidence there."""
        values = self._asdict() | {"cost": self.cost.record(pace)}
        return {("evidence" if name == "value" else name): value for name, value in values.items()}


def unknown(unit: str, threshold: float, cost: Cost, why: str) -> Evidence:
    """No means to judge: off."""
    return Evidence(False, None, unit, None, threshold, cost, f"cannot be judged: {why}")


def photo_cost(frames: Sequence[Frame], passes: float, numbers: int, note: str) -> Cost:
    """Of so many passes over the values of a photo, forward and back, and so many numbers with two moments each."""
    values = np.mean([3 * frame.width * frame.height for frame in frames])
    return Cost(float(passes * values), 12 * numbers, note)


def gaussian_cost(passes: float, numbers: int, note: str) -> Cost:
    """The same of every Gaussian, at `GAUSSIANS` of them."""
    return Cost(passes * GAUSSIANS, 12 * numbers * GAUSSIANS, f"{note}, at {GAUSSIANS:,} Gaussians")


def pace() -> float:
    """Seconds that going over one value takes a step here, from two arrays multiplied, the least of a few times."""
    array, seconds = np.ones(_TIMED, np.float32), []
    out = np.empty_like(array)
    for _ in range(_TIMES):
        started = time.perf_counter()
        np.multiply(array, array, out=out)
        seconds.append(time.perf_counter() - started)
    return _DEARER * min(seconds) / _TIMED
