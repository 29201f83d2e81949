"""What does each setting trade, accuracy for time?

    python experiments/compare.py settings --scene runs/demo/scene --out DIR --seeds 3 --record

One setting is changed at a time, from those of the demo, with true normals.
"""

from collections.abc import Mapping
from typing import Any

from gsjax.pipeline.demo import SURFACE_POINTS

ON = "demo"
POINTS = SURFACE_POINTS


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """The default and what differs from it, by name."""
    phases, gaussians = config["schedule"]["phases"], config["model"]["max_gaussians"]

    def steps(factor: float) -> dict[str, Any]:
        longer = {phase["name"]: {"steps": round(factor * phase["steps"])} for phase in phases}
        density = {name: round(factor * config["density"][name]) for name in ("start", "stop", "every")}
        return {"schedule": {"phases": longer}, "density": density}

    changes = {
        f"default: {gaussians:,} Gaussians, {sum(each['steps'] for each in phases):,} steps": {},
        "half of the Gaussians": {"model": {"max_gaussians": gaussians // 2}},
        "twice the Gaussians": {"model": {"max_gaussians": 2 * gaussians}},
        "half of the steps": steps(0.5),
        "twice the steps": steps(2),
        "3DGS's densification, not by error": {"density": {"rule": "adc"}},
        f"harmonics of degree 3, not {config['model']['sh_degree']}": {"model": {"sh_degree": 3}},
        "surface terms in every step, not every fourth": {"schedule": {"phases": {"surface": {"surface_every": 1}}}},
        "no surface terms": {"schedule": {"vanilla": True}},
    }
    true_normals = {"supervision": {"normals": "{scene}/normals"}}
    return {name: change | true_normals for name, change in changes.items()}
