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

from gsjax.settings import DEMO, NORMAL_TERMS

TERMS = {  # what a step costs, in plain ones, and the weights
    "vanilla": (1.00, {}),
    "SuGaR, sdf": (4.23, {"sugar_sdf": 0.2}),
    "SuGaR, density": (3.01, {"sugar_density": 0.2}),
    "2DGS, depth_normal": (2.10, {"depth_normal": 0.05}),
    "DN-Splatter, axis_normal": (1.78, {"axis_normal": 0.2}),
    "ours, sdf_normal": (2.10, {"sdf_normal": 0.2}),
    "ours, sdf_central": (2.16, {"sdf_central": 0.2}),
    "ours, sdf_bicubic": (2.17, {"sdf_bicubic": 0.2}),
    "ours, sdf_offset": (2.19, {"sdf_offset": 0.2}),
    "ours, density_center": (3.61, {"density_center": 0.2}),
    "ours, density_offset": (3.61, {"density_offset": 0.2}),
    "ours, density_sample": (3.63, {"density_sample": 0.2}),
    "ours, pixel_normal": (1.36, {"pixel_normal": 0.2}),
    "ours, pixel_normal 0.1": (1.36, {"pixel_normal": 0.1}),
    "ours, demo": (2.23, DEMO["phases"][-1]["weights"]),
}


def at_equal_time(phases: list[dict], terms: dict[str, tuple[float, dict[str, float]]]) -> dict[str, dict]:
    """Variants by name: the phases, the last of each term as long as takes the time of the mix, `ours, demo`.

    Depth is the mean of all splats' in each of them, as in the paper.

    Args:
        phases: Of the mix.
        terms: What a step of the last phase costs, and its weights.
    """
    *first, last = phases
    time = terms["ours, demo"][0] * last["steps"]
    shared = {"rates": {"decay_steps": sum(phase["steps"] for phase in phases)}, "depth_mode": "plane"}
    return {
        name: {"phases": [*first, {**last, "steps": round(time / cost), "weights": weights}]}
        | ({} if NORMAL_TERMS.isdisjoint(weights) else {"normals": "{scene}/normals"})
        | shared
        for name, (cost, weights) in terms.items()
    }


CONFIG: dict = {"base": "demo", "variants": at_equal_time(DEMO["phases"], TERMS)}
