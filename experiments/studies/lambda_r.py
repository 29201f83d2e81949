"""The weight of R at the means: from too little to too much, both signs, and the sum over the means for their mean.

From the demo's plain phase on, true normals. A sum is a mean with the number of Gaussians in its weight.
"""

from gsjax.settings import DEMO

_VANILLA, _SURFACE = DEMO["phases"]


def _weighted(weight: float) -> dict:
    return {"phases": [_VANILLA, {**_SURFACE, "weights": {"sdf_normal": weight}}], "normals": "{scene}/normals"}


CONFIG: dict = {
    "base": "demo",
    "variants": {
        "none": {"phases": [_VANILLA, {**_SURFACE, "weights": {}}]},
        **{f"{weight:g}": _weighted(weight) for weight in (0.05, 0.1, 0.2, 0.4, 0.8)},
        "-0.2, as printed": _weighted(-0.2),
        "0.2, a sum": _weighted(0.2 * DEMO["max_gaussians"]),
    },
}
