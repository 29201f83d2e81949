"""How long a run will take, from the time that its first steps took."""

import time

from gsjax.training.plan import Plan, PlannedPhase

COSTS = {"depth": 0.3, "axes": 0.3, "gaussians": 0.7, "neighbor": 1.5}
"""What each of the needs of its terms adds to a step with surface terms, in units of a step of the image alone
(experiments/results/price_on_photos.md, "Where a price would come from"); with Gaussians, the SDF gradient at them."""

FIXED_COST = 0.35  # Of a step at full size, what does not shrink with the photos: the Gaussians' own part.
UNTIMED, TIMED = 4, 16  # Steps of a phase: the first ones compile (all kinds of `fast`), the next are timed.


class Pace:
    """Times the first steps of every phase."""

    def __init__(self):
        """Before the first step."""
        self._phase: PlannedPhase | None = None
        self._steps, self._began = 0, 0.0

    def seconds_per_step(self, phase: PlannedPhase) -> float | None:
        """To be called after every step: a number once a phase, when enough of its steps have been timed."""
        if phase is not self._phase:
            self._phase, self._steps = phase, 0
        self._steps += 1
        if self._steps == UNTIMED:
            self._began = time.perf_counter()
        done = self._steps == UNTIMED + TIMED
        return (time.perf_counter() - self._began) / TIMED if done else None


def relative_cost(phase: PlannedPhase) -> float:
    """A step of a phase, on average, in units of a step of the image alone at full size."""
    image = image_cost(phase.scale)
    if not any(each.is_surface for each in phase.terms):
        return image
    surface = image_cost(phase.scale * phase.surface_scale) * (1 + sum(COSTS.get(need, 0.0) for need in phase.needs))
    return image + (surface - image) / phase.surface_every


def image_cost(scale: int) -> float:
    """A step of the image alone on photos so many times smaller, in units of one at full size."""
    return FIXED_COST + (1 - FIXED_COST) / scale**2


def seconds_left(plan: Plan, step: int, phase: PlannedPhase, seconds_per_step: float) -> float:
    """Seconds for the steps after `step`, at the pace of the phase that runs.

    In a phase that densifies, steps become longer, so the number is a lower bound there. Each phase estimates anew.
    """
    unit = seconds_per_step / relative_cost(phase)
    return sum(max(each.end - max(step, each.begin), 0) * relative_cost(each) * unit for each in plan.phases)


def duration_text(seconds: float) -> str:
    """A duration as one says it: `40 s`, `12 min`, `3.5 h`."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
