"""What does the surface phase of `fast` cost in pictures, at equal time, and what is the gate worth there?

    python experiments/compare.py price_on_photos --scene PHOTOS --out DIR

Photos of 400 pixels and 30,000 Gaussians, so that a run is minutes on a CPU. Exposures are undone in every variant, and
pictures compared in the light of the photos taken near (`psnr_near_gains`): where they are not, plain training gains
most. `view_by_view.py` tells whether a difference hangs on one view. After the coarse phase every variant has the time
of `fast`'s plain phase and of its surface phase, by what a step costs (`COST`): plain steps; the surface phase as it
is; the same with all normals and comparisons, whatever photos agree about; and the phase in place of the plain one as
well, while Gaussians multiply. The maps are those of the run's own depth, and made beside that time.
"""

from collections.abc import Mapping
from typing import Any

ON = "base"
COST = 4.04
"""Of a step with the terms of the surface, in plain ones (`benchmarks/step_cost.py price_on_photos RUN`, AMD EPYC)."""


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Plain steps, the config's surface phase, the same without the gate, and early ones."""
    del on
    coarse, plain, surface = config["phases"]

    def longer(every: int) -> float:
        return 1 + (COST - 1) / every

    time = surface["steps"] * longer(surface["surface_every"])
    untold = {**surface, "steps": round(time), "weights": {}, "surface_every": 1}

    def early(every: int) -> list[dict[str, Any]]:
        steps = round((time + plain["steps"]) / longer(every))
        return [coarse, {**surface, "steps": steps, "surface_every": every, "density_control": True}]

    small = {
        "rates": {"decay_steps": sum(phase["steps"] for phase in config["phases"])},
        "longest_side": 400,
        "max_gaussians": 30_000,
        "normals": None,
        "effects": "exposure",
    }
    phases = {
        "plain": {"phases": [coarse, plain, untold]},
        "surface": {"phases": config["phases"]},
        "surface, not gated": {"phases": config["phases"], "normal_gate": False},
        "early, every 4th": {"phases": early(4)},
        "early, every 8th": {"phases": early(8)},
    }
    return {name: {**each, **small} for name, each in phases.items()}
