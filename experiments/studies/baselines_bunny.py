"""What makes meshes, on a scanned mesh on a plane: `baselines.py` there, with the costs of its steps.

Costs are those of a step on `bunny_plane` (`benchmarks/steps.py baselines_bunny RUN`), in plain ones.
"""

from configs.bunny_plane import CONFIG as BUNNY
from studies.baselines import TERMS, at_equal_time

_COSTS = {
    "vanilla": 1.00,
    "SuGaR, sdf": 4.71,
    "SuGaR, density": 3.32,
    "2DGS, depth_normal": 2.29,
    "DN-Splatter, axis_normal": 2.04,
    "ours, sdf_normal": 2.09,
    "ours, pixel_normal": 1.31,
    "ours, pixel_normal 0.1": 1.31,
    "ours, demo": 2.52,
}
CONFIG: dict = {
    "base": "bunny_plane",
    "variants": at_equal_time(
        BUNNY["phases"], {name: TERMS[name]._replace(cost=cost) for name, cost in _COSTS.items()}
    ),
}
