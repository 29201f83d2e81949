"""What does the surface phase of `fast` cost in pictures, when it begins and how much its terms weigh, at equal time?

    python experiments/compare.py price_on_photos --scene PHOTOS --out DIR

Photos of 400 pixels and 30,000 Gaussians, so that a run is minutes on a CPU. Exposures are undone in every variant, and
pictures compared in the light of the photos taken near (`psnr_near_gains`): where they are not, plain training gains
most, in a hand-held room 1.0 dB over `fast` instead of 0.4. After the coarse phase every variant has the time of
`fast`'s plain phase and of 500 steps of its surface phase, by what a step costs (`COST`): plain steps; its surface
phase without R and as it is; the same at a fifth of its weights in every fourth step; and such a phase in place of the
plain one as well, while Gaussians multiply, at several shares of the weights and in every eighth step. The maps are
those of the run's own depth, gated, and made beside that time.
"""

from collections.abc import Mapping
from typing import Any

ON = "base"
COST = {"plain": 1.0, "photos that agree": 2.87, "with R": 4.04}
"""Of a step with these terms, in plain ones (`benchmarks/step_cost.py price_on_photos RUN`, AMD EPYC)."""
_AGREEING = ("multi_view", "photometric")
_EARLY = (1.0, 4), (0.5, 4), (0.2, 4), (1.0, 8)  # share of the weights, and one in how many steps has the terms


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Plain steps, the photos' own terms, the config's surface phase, a lighter one, and early ones."""
    del on
    coarse, plain, surface = config["phases"]
    weights, every = surface["weights"], surface["surface_every"]
    time = surface["steps"] * (1 + (COST["with R"] - 1) / every)

    def ending(terms: Mapping[str, float], kind: str, every: int, of: float = time, **more: Any) -> dict[str, Any]:
        steps = round(of / (1 + (COST[kind] - 1) / every))
        return {**surface, "steps": steps, "weights": dict(terms), "surface_every": every, **more}

    def early(share: float, every: int) -> list[dict[str, Any]]:
        return [coarse, ending(_shared(weights, share), "with R", every, time + plain["steps"], density_control=True)]

    late = {
        "plain": ending({}, "plain", 1),
        "photos that agree": ending({name: weights[name] for name in _AGREEING}, "photos that agree", every),
        "with R": ending(weights, "with R", every),
        "a fifth, every 4th": ending(_shared(weights, 0.2), "with R", 4),
    }
    phases = {name: [coarse, plain, phase] for name, phase in late.items()}
    phases |= {f"early, {share:.0%}, every {every}th": early(share, every) for share, every in _EARLY}
    steps = sum(phase["steps"] for phase in config["phases"])
    small = {
        "rates": {"decay_steps": steps},
        "longest_side": 400,
        "max_gaussians": 30_000,
        "normals": None,
        "effects": "exposure",
    }
    return {name: {"phases": each, **small} for name, each in phases.items()}


def _shared(weights: Mapping[str, float], share: float) -> dict[str, float]:
    return {name: share * weight for name, weight in weights.items()}
