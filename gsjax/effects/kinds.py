"""The record of an effect: all that diagnosis, planning, training and reports need to know of one."""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import optax

from gsjax.effects.evidence import Evidence, Findings, Masks
from gsjax.effects.observations import Observations
from gsjax.effects.photo_gains import Fit, Table
from gsjax.effects.simulation import Effect
from gsjax.settings import EFFECTS, Density


@dataclass(frozen=True)
class PhotoSet:
    """V photos by C cameras, before any training."""

    names: tuple[str, ...]  # of the photos
    trained: np.ndarray  # [V] bool: not held out
    camera: np.ndarray  # [V] int32, whose camera, 0..C-1
    centers: np.ndarray  # [V, 3] float64 of the cameras, world
    distance: float  # scene units: the median depth of the points in all photos
    tracked: bool  # whether any point was matched in any photo

    @property
    def num_cameras(self) -> int:
        """C."""
        return int(self.camera.max()) + 1


class StartInputs(NamedTuple):
    """What the start of an effect is computed from."""

    observations: Observations
    photos: PhotoSet
    skies: Masks  # where photos show sky, if the run knows of one
    light: Table  # logarithms of display-coded colours, which training compares, less what other effects explain
    fit: Fit  # of `light`


@dataclass(frozen=True)
class EffectKind:
    """One effect, and how it is treated. A function that is None does not apply to it."""

    judge: Callable[[Findings], Evidence]
    # (start, photos, schedule of the run by `peak`, `hold`, `share` and `final`) -> what training simulates
    simulate: Callable[[Any, PhotoSet, Callable[..., optax.Schedule]], Effect] | None = None
    start: Callable[[StartInputs], Any] | None = None  # what tracks and photos imply before any training
    # (start, inputs) -> `[N, 1]`, what it explains of `StartInputs.light`; such effects start before all others
    explain: Callable[[Any, StartInputs], np.ndarray] | None = None
    # (start, numbers after training, None: before, photos) -> fields of `gsjax.effects.start.Learned`
    learned: Callable[[Any, Any, PhotoSet], dict[str, Any]] | None = None
    is_proposed: bool = True  # "auto" may enable it
    on_evidence: bool = False  # a run that is too short for validation simulates it on evidence alone
    per_photo: bool = False  # a checkpoint has one row for each training photo
    photos_to_leave_out: Callable[[Observations], tuple[str, ...]] | None = None  # names
    # (photos, grey under the renders, most and least `[V, 3]` that photos multiply light by) -> whether that is enough
    is_needless: Callable[[Observations, float, np.ndarray, np.ndarray], bool] | None = None
    uncovers: str | None = None  # the effect that is seen where this one removes Gaussians
    masked_terms: str | None = None  # its masks enable the loss terms that need this word of `training.terms.NEEDS`
    delay_densification: Callable[[Density, int], Density] | None = None  # by the steps of the phases that densify


def effect_kinds() -> Mapping[str, EffectKind]:
    """The records of all effects by name, in the order in which they are validated."""
    return {name: importlib.import_module(module).EFFECT for name, module in EFFECTS.items()}
