"""What do normals with errors of a known size do to what is aligned with them?

    python experiments/perturb_normals.py SCENE
    python experiments/compare.py wrong_normals --scene SCENE --out DIR --seeds 3 [--on bunny_plane]

The first command writes the maps. Methods and their time are those of `baselines.py`.
"""

from collections.abc import Mapping
from typing import Any

from studies import baselines

ON = "built_in"
_MAPS = {
    "true": "{scene}/normals",
    "5 degrees": "{scene}/normals_5deg",
    "10 degrees": "{scene}/normals_10deg",
    "20 degrees": "{scene}/normals_20deg",
    "a fifth wrong": "{scene}/normals_fifth_wrong",
    "own": None,
}
_METHODS = {
    "ours": "ours, sdf_normal",
    "ours, pixels": "ours, pixel_normal",
    "ours, pixels in every 4th step": "ours, pixel_normal in every 4th step",
    "ours, mix": "ours, mix",
    "DN-Splatter": "DN-Splatter, axis_normal",
}


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Plain training, and every method with every kind of normals."""
    true = baselines.variants(config, on)
    return {
        "vanilla": true["vanilla"],
        **{
            f"{method}, {kind}": true[name] | {"normals": maps}
            for method, name in _METHODS.items()
            for kind, maps in _MAPS.items()
        },
    }
