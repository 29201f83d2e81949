"""How strong should R at the means be, and what does the printed sign do?

    python experiments/compare.py lambda_r --scene runs/demo/scene --out DIR

From too little to too much, both signs, and the sum over the means for their mean: a sum is a mean with the number of
Gaussians in its weight. All begin with the config's plain phases and have true normals.
"""

from collections.abc import Mapping
from typing import Any

ON = "built_in"


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Plain training, and every weight."""
    del on
    *plain, surface = config["phases"]

    def weighted(weight: float) -> dict[str, Any]:
        phases = [*plain, {**surface, "weights": {"sdf_normal": weight}, "surface_every": 1}]
        return {"phases": phases, "normals": "{scene}/normals"}

    return {
        "none": {"phases": [*plain, {**surface, "weights": {}}]},
        **{f"{weight:g}": weighted(weight) for weight in (0.05, 0.1, 0.2, 0.4, 0.8)},
        "-0.2, as printed": weighted(-0.2),
        "0.2, a sum": weighted(0.2 * config["max_gaussians"]),
    }
