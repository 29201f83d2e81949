"""What errors of a known size in the normals do to what is aligned with them (`experiments/wrong_normals.py`).

Surface phases take the time of the demo's, as in `baselines.py`.
"""

from gsjax.settings import DEMO

_VANILLA, _SURFACE = DEMO["phases"]
_TIME = 2.23 * _SURFACE["steps"]  # of the demo's surface phase, in plain steps
_MAPS = {
    "true": "{scene}/normals",
    "5 degrees": "{scene}/normals_5deg",
    "10 degrees": "{scene}/normals_10deg",
    "20 degrees": "{scene}/normals_20deg",
    "a fifth wrong": "{scene}/normals_fifth_wrong",
    "own": None,
}
_TERMS = {  # what a step costs, in plain ones, and the weights
    "ours": (2.10, {"sdf_normal": 0.2}),
    "ours, pixels": (1.36, {"pixel_normal": 0.2}),
    "ours, demo": (2.23, _SURFACE["weights"]),
    "DN-Splatter": (1.78, {"axis_normal": 0.2}),
}


def _phases(cost: float, weights: dict[str, float]) -> list[dict]:
    return [_VANILLA, {**_SURFACE, "steps": round(_TIME / cost), "weights": weights}]


_RATES = {"rates": {"decay_steps": _VANILLA["steps"] + _SURFACE["steps"]}}
CONFIG: dict = {
    "base": "demo",
    "variants": {
        "vanilla": {"phases": _phases(1.0, {}), **_RATES},
        **{
            f"{method}, {kind}": {"phases": _phases(*described), "normals": maps, **_RATES}
            for method, described in _TERMS.items()
            for kind, maps in _MAPS.items()
        },
    },
}
