"""What does the surface phase of `fast` cost in pictures of real photos, and R's part in it, at equal time?

    python experiments/compare.py price_on_photos --scene PHOTOS --out DIR --seeds 3

Photos of 400 pixels and 30,000 Gaussians, so that a run is minutes on a CPU; no effects: pictures are compared as they
are rendered. Each variant's last phase takes the time of 500 steps of `fast`'s, by what a step costs (`COSTS`): plain
steps, the terms that compare photos, and these with R. The maps are those of the run's own depth, gated, and made
beside that time.
"""

from collections.abc import Mapping
from typing import Any

from studies.baselines import Method, at_equal_time

ON = "base"
COSTS = {"plain": 1.0, "photos that agree": 2.87, "with R": 4.04}
"""Of a step with a variant's terms, in plain ones (`benchmarks/step_cost.py price_on_photos RUN`, AMD EPYC)."""
_AGREEING = ("multi_view", "photometric")


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Plain steps, the photos' own terms, and the config's surface phase."""
    del on
    *_, surface = config["phases"]
    whole, every = surface["weights"], surface["surface_every"]
    weights = {"plain": {}, "photos that agree": {name: whole[name] for name in _AGREEING}, "with R": whole}
    methods = {name: Method(COSTS[name], weights[name], every) for name in COSTS}
    time = 1 + (COSTS["with R"] - 1) / every
    small = {"longest_side": 400, "max_gaussians": 30_000, "normals": None}
    found = at_equal_time(config["phases"], methods, time, depth_mode=config["depth_mode"])
    return {name: {**one, **small} for name, one in found.items()}
