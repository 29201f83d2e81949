"""What each change to the surface brings alone, and all of them together: growth, depth, pixel filter, weights.

The first variant is the demo as it was without them, the last the demo; settled meshes are common to all
(`gsjax.meshing.settling`).
"""

from typing import Any

from gsjax.config import merge
from gsjax.settings import DEMO

_VANILLA, _SURFACE = DEMO["phases"]


def _weights(**weights: float) -> dict[str, Any]:
    return {"phases": [_VANILLA, {**_SURFACE, "weights": weights}]}


_BEFORE = {
    "normals": "{scene}/normals",
    "density": {"rule": "adc"},
    "depth_mode": "center",
    "pixel_filter": "classic",
    **_weights(sdf_normal=0.05, pixel_normal=0.1),
}
_CHANGES: dict[str, dict[str, Any]] = {
    "growth by error": {"density": {"rule": "error"}},
    "plane depth": {"depth_mode": "plane"},
    "depth in front": {"depth_mode": "front"},
    "mip filter": {"pixel_filter": "mip"},
    "weights": _weights(**_SURFACE["weights"]),
}
CONFIG: dict = {
    "base": "demo",
    "variants": {
        "before": _BEFORE,
        **{name: merge(_BEFORE, change) for name, change in _CHANGES.items()},
        "all": merge(_BEFORE, *_CHANGES.values()),
    },
}
