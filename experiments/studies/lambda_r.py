"""How strong should R at the means be, and what does the printed sign do?

    python experiments/compare.py lambda_r --scene runs/demo/scene --out DIR
    python experiments/compare.py lambda_r --on photos_short --scene PHOTOS --out DIR

From too little to too much, both signs, and the sum over the means for their mean: a sum is a mean with the number of
Gaussians in its weight. All begin with the config's plain phases and have true normals. On photos, which have none, the
weights of the paper's range with normals of the run's own depth.
"""

from collections.abc import Mapping
from typing import Any

from configs import WITH_TRUE_NORMALS

ON = "built_in"


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Plain training, and every weight."""
    *plain, surface = config["phases"]

    def weighted(weight: float) -> dict[str, Any]:
        phases = [*plain, {**surface, "weights": {"sdf_normal": weight}, "surface_every": 1}]
        return {"phases": phases, "normals": "{scene}/normals" if on in WITH_TRUE_NORMALS else None}

    none = {"none": {"phases": [*plain, {**surface, "weights": {}}]}}
    if on not in WITH_TRUE_NORMALS:
        return none | {f"{weight:g}": weighted(weight) for weight in (0.1, 0.2, 0.4)}
    return none | {
        **{f"{weight:g}": weighted(weight) for weight in (0.05, 0.1, 0.2, 0.4, 0.8)},
        "-0.2, as printed": weighted(-0.2),
        "0.2, a sum": weighted(0.2 * config["max_gaussians"]),
    }
