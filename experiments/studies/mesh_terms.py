"""What do the regularisers of other mesh makers bring, beside the normal term and without it?

    python experiments/compare.py mesh_terms --scene runs/demo/scene --out DIR

Weights are those of their authors, whose loss of the image is ours (0.8 L1 + 0.2 D-SSIM). `depth_normal` 0.05 (2DGS),
`multi_view` 0.03 and `photometric` 0.15 (PGSR) are means as theirs are. 2DGS's distortion has 1000 (single objects) in
device coordinates of near 0.2; ours counts in depths of the surface, so the same pull is 1000 (0.2 / z)^2 = 40 / z^2, z
the distance of the object in 2DGS's unit: somewhat under 3 there (its meshes are fused to a depth of 3), hence 5.
"""

from collections.abc import Mapping
from typing import Any

ON = "built_in"
_TERMS = {"distortion": 5.0, "depth_normal": 0.05, "multi_view": 0.03, "photometric": 0.15}


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Each term alone, the two that compare photos, all; each beside the config's own terms with true normals."""
    del on
    *plain, surface = config["phases"]
    flat = {"thickness": surface["weights"]["thickness"]}

    def without(*names: str) -> dict[str, Any]:
        """A surface phase of these terms, without normals."""
        weights = flat | {name: _TERMS[name] for name in names}
        return {"phases": [*plain, {**surface, "weights": weights, "surface_every": 1}]}

    def beside(*names: str) -> dict[str, Any]:
        """The config's surface phase with true normals, and these terms."""
        weights = surface["weights"] | {name: _TERMS[name] for name in names}
        phases = [*plain, {**surface, "weights": weights, "surface_every": 1}]
        return {"phases": phases, "normals": "{scene}/normals"}

    return {
        "no term": without(),
        **{name: without(name) for name in _TERMS},
        "multi_view, photometric": without("multi_view", "photometric"),
        "all four": without(*_TERMS),
        "normals": beside(),
        **{f"normals and {name}": beside(name) for name in _TERMS},
    }
