"""What a scene says about one effect: a statistic, how far it can be trusted, and what follows."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from gsjax.effects.observations import Observations
from gsjax.effects.parallax import Parallax
from gsjax.effects.photo_gains import Gains
from gsjax.effects.pose_steps import Step

Masks = Mapping[str, np.ndarray]
"""Frame's name -> `[H, W]` bool, True where it shows sky; photos without sky have none."""


class Findings(NamedTuple):
    """What photos and tracks show, for every effect to judge."""

    observations: Observations
    gains: Gains | None  # None: no point is seen in three photos
    steps: tuple[Step | None, ...]  # a frame
    masks: Masks  # of what looks like sky, plaster included
    of_masks: Parallax | None  # what compares within them; None: nothing


class Evidence(NamedTuple):
    """The report line of an effect."""

    on: bool  # the scene calls for it
    value: float | None  # larger speaks more for the effect; None: the scene has no means to judge
    unit: str
    noise: float | None  # what `value` may be off by, or what it is where the effect is absent
    threshold: float  # `on` needs a larger value
    note: str
    is_certain: bool = False  # the effect is simulated without a validation run

    def record(self) -> dict[str, Any]:
        """Plain values for a file; the statistic is called evidence there."""
        return {("evidence" if name == "value" else name): value for name, value in self._asdict().items()}


def unknown(unit: str, threshold: float, why: str) -> Evidence:
    """No means to judge: off."""
    return Evidence(False, None, unit, None, threshold, f"cannot be judged: {why}")
