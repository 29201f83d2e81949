"""What does R cost in pictures, and which weights have its normals and meshes for the least?

    python experiments/compare.py price_of_r --scene runs/demo/scene --out DIR --seeds 3
    python experiments/compare.py price_of_r --on bunny_plane --scene BUNNY --out DIR

After the config's plain phases: plain steps, the mix of R in every step, and R at the pixels in every fourth step with
`thickness`, all for the same steps; the last also for the time of the plain ones, and from `EARLY` on, while Gaussians
multiply, with R, for as many steps and for the time of the plain ones, and with `thickness` alone. True normals.
"""

from collections.abc import Mapping
from typing import Any

from studies.baselines import MIX, WEIGHTS, Method, at_equal_time

ON = "built_in"
EARLY = 500  # plain steps before the surface phase
_COST = 1.61  # of a step with R at the pixels, in plain ones (`native` backend, AMD EPYC without AVX-512)
_THICKNESS = 0.02


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Plain training, the mix, every weight, and the terms of the first from early on."""
    del on
    *first, plain, surface = config["phases"]
    before = EARLY - sum(phase["steps"] for phase in first)

    def rarely(weight: float, cost: float) -> Method:
        return Method(cost, {"pixel_normal": weight, "thickness": _THICKNESS}, every=4)

    methods = {
        "plain": Method(1, {}),
        "mix": Method(1, WEIGHTS[MIX]),
        **{f"{weight:g}": rarely(weight, 1) for weight in (0.25, 0.3, 0.4)},
        **{f"{weight:g}, the time of plain": rarely(weight, _COST) for weight in (0.2, 0.3)},
    }
    late = at_equal_time(config["phases"], methods, 1)

    def early(weights: Mapping[str, float], cost: float = 1.0) -> dict[str, Any]:
        """The surface phase has the plain steps after `EARLY`, and Gaussians multiply in it."""
        steps = round((surface["steps"] + plain["steps"] - before) / (1 + (cost - 1) / 4))
        longer = {"steps": steps, "density_control": True, "surface_every": 4, "weights": weights}
        return late["0.25"] | {"phases": [*first, plain | {"steps": before}, surface | longer]}

    thin = {"thickness": _THICKNESS}
    r_and_thin = {"pixel_normal": 0.25} | thin
    return late | {
        "0.25, early": early(r_and_thin),
        "0.25, early, the time of plain": early(r_and_thin, _COST),
        "thickness, early": early(thin),
    }
