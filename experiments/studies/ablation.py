"""What does each surface term of the demo add to vanilla training, at the demo's weights?

    python experiments/compare.py ablation --scene runs/demo/scene --out DIR --seeds 3 --record

Every variant has the phases, the steps and the true normals of the demo; the weights of its surface phase differ.
`sdf_normal` is the paper's R, composited by the rasterizer. `pixel_normal` is R at the surface point of each pixel.
"""

from collections.abc import Mapping
from typing import Any

from gsjax.pipeline.demo import SURFACE_POINTS
from gsjax.presets import DEMO

ON = "demo"
POINTS = SURFACE_POINTS
WEIGHTS: dict[str, float] = DEMO["schedule"]["phases"][-1]["weights"]


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """No surface term, R in both forms and `thickness` by themselves, all terms but the composited R, and all."""
    del on
    *first, last = config["schedule"]["phases"]

    def with_terms(*names: str) -> dict[str, Any]:
        phase = last | {"weights": {name: WEIGHTS[name] for name in names}}
        return {"schedule": {"phases": [*first, phase]}, "supervision": {"normals": "{scene}/normals"}}

    return {
        "vanilla": with_terms(),
        "+ R composited": with_terms("sdf_normal"),
        "+ R at pixels": with_terms("pixel_normal"),
        "+ `thickness`": with_terms("thickness"),
        "+ all but R composited": with_terms(*(name for name in WEIGHTS if name != "sdf_normal")),
        "+ all (the demo)": with_terms(*WEIGHTS),
    }
