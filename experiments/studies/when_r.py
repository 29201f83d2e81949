"""When should R act: in which part of the surface phase's time, in how many of its steps, with what weight?

    python experiments/compare.py when_r --scene runs/demo/scene --out DIR --seeds 3

R is at the pixels. All else, the time among it, is as in `baselines.py`; the rest of the phase is plain.
"""

from collections.abc import Mapping
from typing import Any

from studies.baselines import MIX, Method, at_equal_time, costs_on

ON = "built_in"
_WHEN: dict[str, dict[str, Any]] = {
    "0.1, first half": {"within": (0, 1 / 2)},
    "0.2, first half": {"within": (0, 1 / 2)},
    "0.1, every 4th, first two thirds": {"every": 4, "within": (0, 2 / 3)},
    "0.2, every 4th, last half": {"every": 4, "within": (1 / 2, 1)},
    "0.1, every 4th": {"every": 4},
    "0.2, every 4th": {"every": 4},
    "0.4, every 8th": {"every": 8},
}
"""By the weight, and when."""


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Plain training, and R at every time."""
    costs = costs_on(on)
    methods = {"vanilla": Method(1.0, {})} | {
        name: Method(costs["ours, pixel_normal"], {"pixel_normal": float(name.split(",")[0])}, **when)
        for name, when in _WHEN.items()
    }
    return at_equal_time(config["phases"], methods, costs[MIX])
