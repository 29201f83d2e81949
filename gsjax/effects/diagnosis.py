"""All effects looked for in one data set."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from gsjax.effects import (
    background,
    blur,
    distortion,
    exposure,
    mip,
    poses,
    sky,
    transients,
    vignetting,
)
from gsjax.effects.evidence import Evidence, pace
from gsjax.effects.observations import Observations, observe
from gsjax.scene import Frame, Scene


@dataclass(frozen=True)
class Diagnosis:
    """What a scene says about every effect, and about every photo."""

    effects: dict[str, Evidence]
    seen: Observations
    gains: exposure.Gains | None
    steps: tuple[poses.Step | None, ...]  # a frame
    sky: sky.Masks

    def record(self) -> dict[str, Any]:
        """Plain values for a file: `effects` by name, and `photos` with gains in EV, sharpness, pose step, sky.

        Milliseconds of the costs are counts of values, at the pace at which this machine multiplies arrays.
        """
        seconds = pace()
        return {
            "effects": {name: evidence.record(seconds) for name, evidence in self.effects.items()},
            "photos": [
                {
                    "name": frame.name,
                    "gains": None if self.gains is None else self.gains.fit.gains[index].tolist(),
                    "sharpness": self.seen.facts[index].sharpness,
                    "pose_step_px": None if (step := self.steps[index]) is None else step.shift,
                    "sky": float(self.sky[frame.name].mean()) if frame.name in self.sky else 0.0,
                }
                for index, frame in enumerate(self.seen.frames)
            ],
        }


def diagnose(scene: Scene, *, progress: Callable[[Iterable[Frame]], Iterable[Frame]] = iter) -> Diagnosis:
    """Look for every effect.

    Args:
        scene: A loaded data set; every photo is read once, and tracks where it has any.
        progress: Wraps the frames, for a bar.

    Returns:
        A `Diagnosis`.

    Raises:
        InputError: A photo or the tracks cannot be read.
    """
    seen = observe(scene, progress=progress)
    masks = sky.find(seen)
    gains, steps = exposure.estimate(seen), poses.gauss_newton_steps(seen)
    effects = {
        "exposure": exposure.judge(seen, gains),
        "vignetting": vignetting.judge(seen, gains),
        "background": background.judge(seen),
        "sky": sky.judge(seen, masks),
        "poses": poses.judge(seen, steps),
        "transients": transients.judge(seen, gains),
        "mip": mip.judge(seen),
        "blur": blur.judge(seen),
        "distortion": distortion.judge(seen),
    }
    return Diagnosis(effects, seen, gains, steps, masks)
