"""What makes meshes, with depth read in front by every method: `baselines.py` so, and R in every fourth step too.

Costs are those of a step on the built-in scene (`benchmarks/steps.py baselines_front RUN`), in plain ones.
"""

from studies.baselines import TERMS, Term, at_equal_time

from gsjax.settings import DEMO

_COSTS = {
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
_ALWAYS = {name: TERMS[name]._replace(cost=cost) for name, cost in _COSTS.items()}
_NOW_AND_THEN = {
    "ours, pixel_normal in every 4th step": Term(_COSTS["ours, pixel_normal"], {"pixel_normal": 0.2}, every=4)
}
CONFIG: dict = {
    "base": "demo",
    "variants": at_equal_time(DEMO["phases"], {**_ALWAYS, **_NOW_AND_THEN}, depth_mode="front"),
}
