"""What should the surface phase learn from: true normals, the run's own smoothed ones, photos that agree, or both?

    python experiments/compare.py supervision --scene BUNNY --out DIR --seeds 3
    python experiments/compare.py supervision --on photos_short --scene PHOTOS --out DIR

Beside plain training for the same steps. Without truth there are held-out photos and pictures of the normals to judge
by.
"""

from collections.abc import Mapping
from typing import Any

from configs import WITH_TRUE_NORMALS

ON = "bunny_plane"
_AGREEING = {"multi_view": 0.03, "photometric": 0.15}  # PGSR's weights


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Plain training, and every supervision; true normals where the config's data set has them."""
    *plain, surface = config["phases"]
    normals = {name: weight for name, weight in surface["weights"].items() if name not in _AGREEING}

    def taught(**weights: float) -> dict[str, Any]:
        return {"phases": [*plain, {**surface, "weights": weights}]}

    true = {"true normals": taught(**normals) | {"normals": "{scene}/normals"}} if on in WITH_TRUE_NORMALS else {}
    return {
        "vanilla": {"vanilla": True},
        **true,
        "own normals": taught(**normals),
        "photos that agree": taught(**_AGREEING),
        "own normals, photos that agree": taught(**normals, **_AGREEING),
    }
