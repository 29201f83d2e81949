"""The record of an effect: its evidence, its simulation, and all else that planning and training need to know."""

import importlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import optax

from gsjax.effects.observations import Observations
from gsjax.effects.parallax import Parallax
from gsjax.effects.photo_gains import Fit, Gains, Table, fit, table
from gsjax.effects.pose_steps import Step
from gsjax.effects.simulation import Effect, Effects
from gsjax.settings import EFFECTS, Density

Masks = Mapping[str, np.ndarray]
"""Frame's name -> `[H, W]` bool, True where it shows sky; photos without sky have none."""

Rate = Callable[..., optax.Schedule]
"""Schedule of a run by `peak`, `hold`, `share` and `final`, see `gsjax.effects.simulation.learning_rate`."""


class Findings(NamedTuple):
    """What photos and tracks show, for every effect to judge."""

    observations: Observations
    gains: Gains | None  # None: no point is seen in three photos
    steps: tuple[Step | None, ...]  # a frame
    masks: Masks  # of what looks like sky, plaster included
    of_masks: Parallax | None  # what compares within them; None: nothing


class Evidence(NamedTuple):
    """The report line of an effect."""

    on: bool  # the scene requires it
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


@dataclass(frozen=True)
class StartInputs:
    """What photos and tracks imply before any training, of V photos by C cameras."""

    observations: Observations
    skies: Masks = field(default_factory=dict)  # where photos show sky, if the run knows of one
    explained: np.ndarray | float = 0.0  # [O, 1] logarithm of light that other effects explain

    @property
    def names(self) -> tuple[str, ...]:
        """Of the photos."""
        return tuple(frame.name for frame in self.observations.frames)

    @property
    def trained(self) -> np.ndarray:
        """`[V]` bool: not held out."""
        return np.array([not frame.held_out for frame in self.observations.frames])

    @property
    def camera(self) -> np.ndarray:
        """`[V]` int32, whose camera, 0..C-1."""
        cameras = [(frame.width, frame.height, frame.K.tobytes()) for frame in self.observations.frames]
        distinct = list(dict.fromkeys(cameras))
        return np.array([distinct.index(camera) for camera in cameras], np.int32)

    @cached_property
    def light(self) -> Table:
        """Logarithms of display-coded colours, which training compares, without what other effects explain."""
        every = self.observations
        return table(np.log(every.colors) - self.explained, every.photo, every.point, len(every.frames))

    @cached_property
    def fit(self) -> Fit:
        """The same robust fit of that light as the evidence has."""
        return fit(self.light)


@dataclass(frozen=True)
class EffectKind:
    """One effect, and how it is treated. A function that is None does not apply to it."""

    judge: Callable[[Findings], Evidence]
    simulate: Callable[[StartInputs, Rate], Effect] | None = None  # over the photos that are trained on
    explain: Callable[[StartInputs], np.ndarray] | None = None  # `[O, 1]` logarithm of light that it explains
    is_proposed: bool = True  # "auto" may enable it
    on_evidence: bool = False  # a run that is too short for validation simulates it on evidence alone
    per_photo: bool = False  # a checkpoint has one row for each training photo
    photos_to_leave_out: Callable[[Observations], tuple[str, ...]] | None = None  # names
    # (photos, grey under the renders, most and least `[V, 3]` that photos multiply light by) -> whether that is enough
    is_needless: Callable[[Observations, float, np.ndarray, np.ndarray], bool] | None = None
    uncovers: str | None = None  # the effect that is visible where this one removes Gaussians
    masked_terms: str | None = None  # its masks enable the loss terms that need this word of `training.terms.NEEDS`
    delay_densification: Callable[[Density, int], Density] | None = None  # by the steps of the phases that densify


def effect_kinds() -> Mapping[str, EffectKind]:
    """The records of all effects by name, in the order in which they are validated."""
    return {name: importlib.import_module(module).EFFECT for name, module in EFFECTS.items()}


def simulations(
    observations: Observations, names: Collection[str], rate: Rate, skies: Masks = MappingProxyType({})
) -> Effects:
    """Those of the named effects that training simulates, from where photos and tracks imply that they start."""
    kinds, inputs = effect_kinds(), StartInputs(observations, skies)
    explained = {name: kind.explain(inputs) for name, kind in kinds.items() if kind.explain and name in names}
    effects = {}
    for name, kind in kinds.items():
        if kind.simulate and name in names:
            of_others = [light for other, light in explained.items() if other != name]
            # The same inputs where nothing is explained: their fit is made once.
            own = replace(inputs, explained=sum(of_others)) if of_others else inputs
            effects[name] = kind.simulate(own, rate)
    return effects
