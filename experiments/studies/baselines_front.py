"""What makes meshes, with depth read in front by every method: `baselines.py` so, and R in every fourth step too.

Costs are those of a step on the built-in scene (`benchmarks/steps.py baselines_front RUN`), in plain ones.
"""

from studies.baselines import TERMS, Term, at_equal_time

from gsjax.settings import DEMO


def in_front(phases: list[dict], costs: dict[str, float]) -> dict[str, dict]:
    """Variants by name: what `costs` names, and R at the pixels in every fourth step, with depth in front."""
    terms = {name: TERMS[name]._replace(cost=cost) for name, cost in costs.items()}
    rarer = Term(costs["ours, pixel_normal"], {"pixel_normal": 0.2}, every=4)
    return at_equal_time(phases, {**terms, "ours, pixel_normal in every 4th step": rarer}, depth_mode="front")


COSTS = {
    "vanilla": 1.00,
    "SuGaR, sdf": 4.47,
    "SuGaR, density": 3.08,
    "2DGS, depth_normal": 2.25,
    "DN-Splatter, axis_normal": 1.80,
    "ours, sdf_normal": 2.29,
    "ours, pixel_normal": 1.48,
    "ours, pixel_normal 0.1": 1.48,
    "ours, demo": 2.40,
}
CONFIG: dict = {"base": "demo", "variants": in_front(DEMO["phases"], COSTS)}
