"""Which reading of the field's gradient should R align with the normals, at equal time?

    python experiments/compare.py r_readings --scene runs/demo/scene --out DIR --seeds 3

The variants of `baselines.py`, with one reading each and the same weight, 0.2. Depth is the mean of all planes, as in
the paper, and costs are those of steps that read it so.
"""

from collections.abc import Mapping
from typing import Any

from studies.baselines import Method, at_equal_time

ON = "built_in"
_COSTS = {
    "sdf_normal": 2.10,
    "sdf_central": 2.16,
    "sdf_bicubic": 2.17,
    "sdf_offset": 2.19,
    "density_center": 3.61,
    "density_offset": 3.61,
    "density_sample": 3.63,
    "pixel_normal": 1.36,
}
_MIX = 2.23


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Plain training, and every reading."""
    del on
    methods = {"vanilla": Method(1.0, {})} | {term: Method(cost, {term: 0.2}) for term, cost in _COSTS.items()}
    return at_equal_time(config["phases"], methods, _MIX, depth_mode="plane")
