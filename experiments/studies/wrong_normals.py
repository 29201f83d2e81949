"""What errors of a known size in the normals do to what is aligned with them (`experiments/wrong_normals.py`).

Surface phases take the time of the demo's and depth is read in front, as in `baselines_front.py`.
"""

from typing import Any

from studies.baselines_front import CONFIG as BASELINES

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
    "ours, demo": "ours, demo",
    "DN-Splatter": "DN-Splatter, axis_normal",
}


def with_maps(true: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Variants by name: plain training, and every method with every kind of normals.

    Args:
        true: The same with true normals, as `baselines_front.in_front` gives them.
    """
    return {
        "vanilla": true["vanilla"],
        **{
            f"{method}, {kind}": true[name] | {"normals": maps}
            for method, name in _METHODS.items()
            for kind, maps in _MAPS.items()
        },
    }


CONFIG: dict = {"base": "demo", "variants": with_maps(BASELINES["variants"])}
