"""What does the surface phase of `fast` cost in pictures, at equal time, and what is the gate worth there?

    python experiments/compare.py price_on_photos --scene PHOTOS --out DIR

Photos of 400 pixels and 30,000 Gaussians, so that a run is minutes on a CPU, with the effects that the photos show.
Every variant has as many steps as take the time of `fast`, by what a step with the terms of the surface costs
(`COSTS`), and its rates fall over its own steps: plain training; `fast` as it is; the same with all normals and
comparisons, whatever photos agree about; with R at the means as well, the paper's; with those terms on photos of full
size; and with splats that lie along the surface from the beginning. The maps are those of the run's own depth, and made
beside that time. Where exposures are undone, pictures are compared in the light of the photos taken near
(`psnr_near_gains`); `view_by_view.py` tells whether a difference hangs on one view.
"""

from collections.abc import Mapping
from typing import Any

ON = "base"
COSTS = {"surface": 1.30, "sdf": 2.03, "full size": 3.07}
"""Of a step with the terms of the surface, in plain ones (`benchmarks/step_cost.py price_on_photos RUN`, AMD EPYC)."""

ALONG = 0.15
"""What `depth_normal` adds to a step of the first phase, in plain ones."""


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Plain training, the config's own, the same without the gate, with the paper's R, on whole photos, and flatter."""
    del on
    coarse, vanilla, surface = config["phases"]
    small = {"longest_side": 400, "max_gaussians": 30_000, "normals": None, "effects": "auto"}

    def time(steps: float, cost: float) -> float:
        return steps * (1 + (cost - 1) / surface["surface_every"])

    def taught(cost: float, along: float = 0.0, **differences: Any) -> dict[str, Any]:
        left = time(surface["steps"], COSTS["surface"]) - (coarse["steps"] * ALONG if along else 0)
        first = {**coarse, "weights": {**coarse.get("weights", {}), "depth_normal": along}}
        return small | {"phases": [first, vanilla, surface | {"steps": round(left / time(1, cost))} | differences]}

    with_means = {"sdf_normal": 0.05, **surface["weights"]}
    return {
        "plain": small | {"phases": taught(1)["phases"], "vanilla": True},
        "surface": taught(COSTS["surface"]),
        "surface, not gated": taught(COSTS["surface"]) | {"normal_gate": False},
        "and R at the means": taught(COSTS["sdf"], weights=with_means),
        "full size": taught(COSTS["full size"], surface_scale=1),
        **{f"depth_normal {weight}": taught(COSTS["surface"], weight) for weight in (0.003, 0.01)},
    }
