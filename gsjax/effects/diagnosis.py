"""The evidence for every effect in one data set."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from gsjax.effects import background, effect_module, exposure, parallax, poses, sky
from gsjax.effects.evidence import Evidence
from gsjax.effects.observations import Observations, observe
from gsjax.effects.sky import Masks
from gsjax.scene import Frame, Scene
from gsjax.settings import EFFECTS


class Findings(NamedTuple):
    """What photos and tracks show, for every effect to judge."""

    observations: Observations
    gains: exposure.Gains | None  # None: no point is seen in three photos
    steps: tuple[poses.Step | None, ...]  # a frame
    bare: parallax.Parallax | None  # of what is bright, smooth and unmatched
    sky: Evidence


@dataclass(frozen=True)
class Diagnosis:
    """What a scene says about every effect, and about every photo."""

    effects: dict[str, Evidence]
    observations: Observations
    gains: exposure.Gains | None
    steps: tuple[poses.Step | None, ...]  # a frame
    sky: Masks  # empty where the evidence is not on
    plain: Masks  # what looks like sky, plaster included; for users who know that there is a sky

    def record(self) -> dict[str, Any]:
        """Plain values for a file: `effects` by name, and `photos` with gains in EV, sharpness, pose step, sky."""
        return {
            "effects": {name: evidence.record() for name, evidence in self.effects.items()},
            "photos": [
                {
                    "name": frame.name,
                    "gains": None if self.gains is None else self.gains.fit.gains[index].tolist(),
                    "sharpness": self.observations.facts[index].sharpness,
                    "pose_step_px": None if (step := self.steps[index]) is None else step.shift,
                    "sky": float(self.sky[frame.name].mean()) if frame.name in self.sky else 0.0,
                }
                for index, frame in enumerate(self.observations.frames)
            ],
        }


def diagnose(scene: Scene, *, progress: Callable[[Iterable[Frame]], Iterable[Frame]] = iter) -> Diagnosis:
    """Judge every effect. Every photo is read once; `progress` wraps the frames, for a bar.

    Raises:
        InputError: A photo or the tracks cannot be read.
    """
    observations = observe(scene, progress=progress)
    gains, steps = exposure.estimate(observations), poses.gauss_newton_steps(observations)
    masks = sky.find(observations)
    of_sky = _parallax(observations, sky.regions(observations, masks), gains)
    above = sky.judge_masks(observations, masks, of_sky)
    of_bare = of_sky if above.on else _parallax(observations, background.bare_regions(observations), gains)
    findings = Findings(observations, gains, steps, of_bare, above)
    effects = {name: effect_module(name).judge(findings) for name in EFFECTS}
    return Diagnosis(effects, observations, gains, steps, masks if above.on else {}, masks)


def _parallax(
    observations: Observations, regions: Mapping[int, np.ndarray], gains: exposure.Gains | None
) -> parallax.Parallax | None:
    """How plain regions compare between photos whose exposure is known from their tracks; None: nothing to compare."""
    if not regions or not len(observations.points):
        return None
    stops = np.zeros((len(observations.frames), 3)) if gains is None else gains.fit.gains
    up = sky.upwards(observations.frames)
    return parallax.compare(observations, regions, stops, np.array([0.0, 0.0, 1.0]) if up is None else up)
