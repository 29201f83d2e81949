"""Where the simulated effects of a run start, by tracks and photos, and what they report after training."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import optax

from gsjax.effects.appearance import Appearance
from gsjax.effects.evidence import Masks
from gsjax.effects.kinds import EffectKind, PhotoSet, StartInputs, effect_kinds
from gsjax.effects.observations import Observations
from gsjax.effects.photo_gains import fit, table
from gsjax.effects.simulation import Effects
from gsjax.scene import Frame
from gsjax.scene.cameras import viewmat_center


@dataclass(frozen=True)
class Start:
    """The effects that a run simulates, before any training."""

    photos: PhotoSet
    values: Mapping[str, Any]  # by effect, what its `EffectKind.start` returned

    def simulations(self, rate: Callable[..., optax.Schedule]) -> Effects:
        """The effects, over the photos that are trained on.

        `rate` is the schedule of the run by `peak`, `hold`, `share` and `final`, see
        `gsjax.effects.simulation.learning_rate`.
        """
        kinds = simulated_kinds(self.values).items()
        return {name: kind.simulate(self.values[name], self.photos, rate) for name, kind in kinds if kind.simulate}

    def learned(self, numbers: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """What the effects report of their numbers by name after training; None: before it.

        `log_gains` `[V, 3]` and `falloff` `[V, 2]` as those of `Appearance`, `moves` of the cameras by photo, and
        `background`, SH coefficients; each only where an effect reports it.
        """
        reports = {}
        for name, kind in simulated_kinds(self.values).items():
            if kind.learned is not None:
                reports |= kind.learned(self.values[name], None if numbers is None else numbers[name], self.photos)
        return reports

    def appearances(self, learned: Mapping[str, Any]) -> dict[str, Appearance]:
        """Of every photo by name, of what `self.learned` returns. Empty where nothing changes the light."""
        if not {*Appearance._fields} & learned.keys():
            return {}
        gains, falloff = self._light(learned)
        rows = zip(self.photos.names, gains.tolist(), falloff.tolist(), strict=True)
        return {name: Appearance(tuple(of_gains), tuple(of_falloff)) for name, of_gains, of_falloff in rows}

    def light_range(self, frames: Sequence[Frame]) -> tuple[np.ndarray, np.ndarray]:
        """`[V, 3]` what each photo multiplies display-coded light by, at most and at least, before training."""
        gains, falloff = self._light(self.learned())
        sizes = np.array([(frame.width, frame.height) for frame in frames])
        centers, focals = (np.array([get(frame.K) for frame in frames]) for get in (lambda K: K[:2, 2], np.diagonal))
        tangents2 = np.square(np.maximum(centers, sizes - centers) / focals[:, :2]).sum(-1)
        corners = np.stack([tangents2, np.square(tangents2)], -1) * falloff
        return np.exp(gains), np.exp(gains + corners.sum(-1, keepdims=True))

    def _light(self, learned: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        """The gains and the fall-off of all photos, zero where no effect reports them."""
        count = len(self.photos.names)
        return learned.get("log_gains", np.zeros((count, 3))), learned.get("falloff", np.zeros((count, 2)))


def simulated_kinds(names: Collection[str] | None = None) -> dict[str, EffectKind]:
    """The records of the effects that training simulates; None: of all, or of the named ones."""
    kinds = effect_kinds().items()
    return {name: kind for name, kind in kinds if kind.simulate and (names is None or name in names)}


def estimate_start(observations: Observations, names: Collection[str], skies: Masks = MappingProxyType({})) -> Start:
    """Where those of the named effects start that are simulated. `skies` are where photos show sky.

    The same robust fit as the evidence, of display-coded values, since those are what training compares.
    """
    photos = _photo_set(observations)
    light = table(np.log(observations.colors), observations.photo, observations.point, len(photos.names))
    inputs, values = StartInputs(observations, photos, skies, light, fit(light)), {}
    for name, kind in sorted(simulated_kinds(names).items(), key=lambda item: item[1].explain is None):
        values[name] = None if kind.start is None else kind.start(inputs)
        if kind.explain is not None:
            light = inputs.light._replace(values=inputs.light.values - kind.explain(values[name], inputs))
            inputs = inputs._replace(light=light, fit=fit(light))
    return Start(photos, values)


def _photo_set(observations: Observations) -> PhotoSet:
    frames = observations.frames
    cameras = [(frame.width, frame.height, frame.K.tobytes()) for frame in frames]
    distinct = list(dict.fromkeys(cameras))
    return PhotoSet(
        tuple(frame.name for frame in frames),
        np.array([not frame.held_out for frame in frames]),
        np.array([distinct.index(camera) for camera in cameras], np.int32),
        np.stack([viewmat_center(frame.viewmat.astype(np.float64)) for frame in frames]),
        _median_depth(observations),
        observations.tracked,
    )


def _median_depth(observations: Observations) -> float:
    """Of some points in front of the cameras; the spread of the cameras where there are none."""
    points = observations.points[:: max(1, len(observations.points) // 1000)]
    depths = np.concatenate([points @ frame.viewmat[2, :3] + frame.viewmat[2, 3] for frame in observations.frames])
    if (depths > 0).any():
        return float(np.median(depths[depths > 0]))
    centers = np.stack([frame.viewmat[:3, 3] for frame in observations.frames])
    return float(np.linalg.norm(centers - centers.mean(0), axis=1).max()) or 1.0
