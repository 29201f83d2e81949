"""What does each regulariser of a surface gain, all else and the time being equal?

    python experiments/compare.py baselines --scene runs/demo/scene --out DIR --seeds 3
    python experiments/compare.py baselines --on bunny_plane --scene BUNNY --out DIR --seeds 3

Every variant is the config's plain phases, then a surface phase whose loss has one regulariser more. Weights are those
of the authors, whose photometric loss is ours (0.8 L1 + 0.2 D-SSIM): 0.2 for SuGaR's pair of terms in either mode, 0.05
for 2DGS's depth-normal consistency; 0.2, the paper's, for all that align something with normals, DN-Splatter's axes
among them, and at the pixels also 0.1, the least that the paper has. SuGaR and 2DGS see no normals. `ours, mix` has R
at the means and at the pixels, in every step, and `thickness`. SuGaR and the paper have an entropy phase and a cull
before, which short runs do not bear; no variant has them.

Each surface phase has as many steps as take the time of the mix, by what a step costs (`STEP_COSTS`): what else a
machine does decides nothing. Rates fall over all steps of a variant, whatever others have. Depth is read in front by
all.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from terms import make_terms

from gsjax.training.terms import TERMS as OURS

ON = "built_in"
MIX = "ours, mix"


class Method(NamedTuple):
    """What the last phase of a variant adds to the loss."""

    cost: float  # of a step with it, in plain ones
    weights: dict[str, float]
    every: int = 1  # one of so many steps has it


WEIGHTS: dict[str, dict[str, float]] = {
    "vanilla": {},
    "SuGaR, sdf": {"sugar_sdf": 0.2},
    "SuGaR, density": {"sugar_density": 0.2},
    "2DGS, depth_normal": {"depth_normal": 0.05},
    "DN-Splatter, axis_normal": {"axis_normal": 0.2},
    "ours, sdf_normal": {"sdf_normal": 0.2},
    "ours, pixel_normal": {"pixel_normal": 0.2},
    "ours, pixel_normal 0.1": {"pixel_normal": 0.1},
    MIX: {"sdf_normal": 0.1, "pixel_normal": 0.4, "thickness": 0.02},
}
_COSTS = {
    "built_in": (1.00, 4.47, 3.08, 2.25, 1.80, 2.29, 1.48, 1.48, 2.40),
    "bunny_plane": (1.00, 5.09, 3.22, 2.40, 1.97, 2.16, 1.45, 1.45, 2.55),
}
STEP_COSTS = {on: dict(zip(WEIGHTS, costs, strict=True)) for on, costs in _COSTS.items()}
"""In plain steps, by config and method, measured on an AMD EPYC (experiments/results/baselines.md)."""


def at_equal_time(phases: list[dict[str, Any]], methods: Mapping[str, Method], mix: float) -> dict[str, dict[str, Any]]:
    """Variants by name: the phases, the last of each method as long as takes the time of the mix.

    Args:
        phases: Of the mix.
        methods: What the last phase has, by name.
        mix: What a step of the mix costs, in plain ones.
    """
    *first, last = phases
    terms = {**OURS, **make_terms(lambda: 1.0)}

    def variant(method: Method) -> dict[str, Any]:
        steps = round(mix * last["steps"] / (1 + (method.cost - 1) / method.every))
        own = {**last, "steps": steps, "weights": method.weights, "surface_every": method.every, "surface_scale": 1}
        reads_normals = any("normals" in terms[name].needs for name in method.weights)
        normals = {"supervision": {"normals": "{scene}/normals"}} if reads_normals else {}
        return {"schedule": {"phases": [*first, own]}, "model": {"depth_mode": "front"}} | normals

    return {name: variant(each) for name, each in methods.items()}


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Every method, and R at the pixels in every fourth step alone; costs are the built-in scene's if not measured."""
    costs = STEP_COSTS.get(on, STEP_COSTS["built_in"])
    methods = {name: Method(costs[name], weights) for name, weights in WEIGHTS.items()}
    rarer = Method(costs["ours, pixel_normal"], {"pixel_normal": 0.2}, every=4)
    phases = config["schedule"]["phases"]
    upto_surface = phases[: [phase["name"] for phase in phases].index("surface") + 1]
    return at_equal_time(upto_surface, {**methods, "ours, pixel_normal in every 4th step": rarer}, costs[MIX])
