"""The evidence for every effect in one data set."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

from gsjax.effects import parallax, photo_gains, sky
from gsjax.effects.kinds import Evidence, Findings, Masks, effect_kinds
from gsjax.effects.observations import Observations, observe
from gsjax.effects.pose_steps import Step, gauss_newton_steps
from gsjax.scene import Frame, Scene


@dataclass(frozen=True)
class Diagnosis:
    """What a scene says about every effect, and about every photo."""

    effects: dict[str, Evidence]
    observations: Observations
    gains: photo_gains.Gains | None
    steps: tuple[Step | None, ...]  # a frame
    sky: Masks  # empty where the evidence is not on
    plain: Masks  # what looks like sky, plaster included; for users who know that there is a sky

    def with_evidence(self, evidence: dict[str, Evidence]) -> "Diagnosis":
        """The diagnosis with other evidence for some effects."""
        return replace(self, effects=self.effects | evidence)

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
    gains, steps = photo_gains.estimate(observations), gauss_newton_steps(observations)
    masks = sky.find(observations)
    of_masks = parallax.compare(observations, sky.regions(observations, masks), gains)
    findings = Findings(observations, gains, steps, masks, of_masks)
    effects = {name: kind.judge(findings) for name, kind in effect_kinds().items()}
    return Diagnosis(effects, observations, gains, steps, masks if effects["sky"].on else {}, masks)
