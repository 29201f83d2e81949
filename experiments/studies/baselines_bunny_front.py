"""What makes meshes, on a scanned mesh on a plane, with depth read in front: `baselines_front.py` there.

Costs are those of a step on `bunny_plane` (`benchmarks/steps.py baselines_bunny_front RUN`), in plain ones.
"""

from configs.bunny_plane import CONFIG as BUNNY
from studies.baselines_front import in_front

_COSTS = {
    "vanilla": 1.00,
    "SuGaR, sdf": 5.09,
    "SuGaR, density": 3.22,
    "2DGS, depth_normal": 2.40,
    "DN-Splatter, axis_normal": 1.97,
    "ours, sdf_normal": 2.16,
    "ours, pixel_normal": 1.45,
    "ours, pixel_normal 0.1": 1.45,
    "ours, demo": 2.55,
}
CONFIG: dict = {"base": "bunny_plane", "variants": in_front(BUNNY["phases"], _COSTS)}
