"""What the regulariser brings beside those that it replaces or competes with; all else is shared, the time too.

Every variant is the demo's plain phase, then a surface phase whose loss has one regulariser more. Weights are those of
the authors, whose photometric loss is ours (0.8 L1 + 0.2 D-SSIM): 0.2 for SuGaR's pair of terms in either mode, 0.05
for 2DGS's depth-normal consistency; 0.2, the paper's, for all that align something with normals, DN-Splatter's axes
among them, and at the pixels also 0.1, the least that the paper has. SuGaR and 2DGS see no normals. `ours, demo` is the
demo's mix (docs/deviations.md says why there is one).

SuGaR and the paper have an entropy phase and a cull before, which short runs do not bear; no variant has them.

Each surface phase has as many steps as take the time of the demo's, by what a step costs on the built-in scene
(`benchmarks/steps.py baselines RUN`, AMD EPYC): what else a machine does decides nothing. Rates fall as over the demo.
"""

from typing import NamedTuple

from gsjax.settings import DEMO, NORMAL_TERMS


class Term(NamedTuple):
    """What the last phase of a variant adds to the loss."""

    cost: float  # of a step with it, in plain ones
    weights: dict[str, float]
    every: int = 1  # one of so many steps has it
    within: tuple[float, float] = (0.0, 1.0)  # which part of the phase's time has it; the rest is plain


TERMS = {
    "vanilla": Term(1.00, {}),
    "SuGaR, sdf": Term(4.23, {"sugar_sdf": 0.2}),
    "SuGaR, density": Term(3.01, {"sugar_density": 0.2}),
    "2DGS, depth_normal": Term(2.10, {"depth_normal": 0.05}),
    "DN-Splatter, axis_normal": Term(1.78, {"axis_normal": 0.2}),
    "ours, sdf_normal": Term(2.10, {"sdf_normal": 0.2}),
    "ours, sdf_central": Term(2.16, {"sdf_central": 0.2}),
    "ours, sdf_bicubic": Term(2.17, {"sdf_bicubic": 0.2}),
    "ours, sdf_offset": Term(2.19, {"sdf_offset": 0.2}),
    "ours, density_center": Term(3.61, {"density_center": 0.2}),
    "ours, density_offset": Term(3.61, {"density_offset": 0.2}),
    "ours, density_sample": Term(3.63, {"density_sample": 0.2}),
    "ours, pixel_normal": Term(1.36, {"pixel_normal": 0.2}),
    "ours, pixel_normal 0.1": Term(1.36, {"pixel_normal": 0.1}),
    "ours, demo": Term(2.23, DEMO["phases"][-1]["weights"]),
}


def at_equal_time(phases: list[dict], terms: dict[str, Term], *, depth_mode: str = "plane") -> dict[str, dict]:
    """Variants by name: the phases, the last of each term as long as takes the time of the mix, `ours, demo`.

    Args:
        phases: Of the mix.
        terms: What the last phase has, by name.
        depth_mode: How depth is read in each of them; as in the paper it is the mean of all splats'.
    """
    *first, last = phases
    time = terms["ours, demo"].cost * last["steps"]
    shared = {"rates": {"decay_steps": sum(phase["steps"] for phase in phases)}, "depth_mode": depth_mode}

    def ending(term: Term) -> list[dict]:
        begin, end = term.within
        steps = round(time * (end - begin) / (1 + (term.cost - 1) / term.every))
        parts = (
            {**last, "name": "before", "steps": round(time * begin), "weights": {}},
            {**last, "steps": steps, "weights": term.weights, "surface_every": term.every},
            {**last, "name": "after", "steps": round(time * (1 - end)), "weights": {}},
        )
        return [part for part in parts if part["steps"]]

    return {
        name: {"phases": [*first, *ending(term)]}
        | ({} if NORMAL_TERMS.isdisjoint(term.weights) else {"normals": "{scene}/normals"})
        | shared
        for name, term in terms.items()
    }


CONFIG: dict = {"base": "demo", "variants": at_equal_time(DEMO["phases"], TERMS)}
