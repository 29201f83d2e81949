"""What makes meshes, on a scanned mesh on a plane: `baselines.py` there, with the costs of its steps.

Costs are those of a step on `bunny_plane` (`benchmarks/steps.py baselines_bunny RUN`), in plain ones.
"""

from configs.bunny_plane import CONFIG as BUNNY

from gsjax.settings import NORMAL_TERMS

_COARSE, _VANILLA, _SURFACE = BUNNY["phases"]
_TERMS = {  # what a step costs, in plain ones, and the weights
    "vanilla": (1.00, {}),
    "SuGaR, sdf": (4.27, {"sugar_sdf": 0.2}),
    "2DGS, depth_normal": (2.22, {"depth_normal": 0.05}),
    "DN-Splatter, axis_normal": (1.94, {"axis_normal": 0.2}),
    "ours, sdf_normal": (2.32, {"sdf_normal": 0.2}),
    "ours, pixel_normal": (1.33, {"pixel_normal": 0.2}),
    "ours, pixel_normal 0.1": (1.33, {"pixel_normal": 0.1}),
    "ours, demo": (2.41, _SURFACE["weights"]),
}
_TIME = _TERMS["ours, demo"][0] * _SURFACE["steps"]


def _variant(cost: float, weights: dict[str, float]) -> dict:
    surface = {**_SURFACE, "steps": round(_TIME / cost), "weights": weights}
    normals = {} if NORMAL_TERMS.isdisjoint(weights) else {"normals": "{scene}/normals"}
    return {"phases": [_COARSE, _VANILLA, surface], **normals}


CONFIG: dict = {
    "base": "bunny_plane",
    "variants": {
        name: _variant(*described) | {"rates": {"decay_steps": sum(phase["steps"] for phase in BUNNY["phases"])}}
        for name, described in _TERMS.items()
    },
}
