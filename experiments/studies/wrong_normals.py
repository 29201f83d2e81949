"""What errors of a known size in the normals do to what is aligned with them (`experiments/wrong_normals.py`)."""

from gsjax.settings import DEMO

_VANILLA, _SURFACE = DEMO["phases"]
_MAPS = {
    "true": "{scene}/normals",
    "5 degrees": "{scene}/normals_5deg",
    "10 degrees": "{scene}/normals_10deg",
    "20 degrees": "{scene}/normals_20deg",
    "a fifth wrong": "{scene}/normals_fifth_wrong",
    "own": None,
}
_TERMS = {
    "ours": {"sdf_normal": 0.2},
    "ours, demo": _SURFACE["weights"],
    "DN-Splatter": {"axis_normal": 0.2},
}
CONFIG: dict = {
    "base": "demo",
    "variants": {
        "vanilla": {"vanilla": True},
        **{
            f"{method}, {kind}": {"phases": [_VANILLA, {**_SURFACE, "weights": weights}], "normals": maps}
            for method, weights in _TERMS.items()
            for kind, maps in _MAPS.items()
        },
    },
}
