"""Which learning rates and which ramp of growth earn the time of `balanced`, whole and in a quarter of its steps?

    python experiments/compare.py balanced --scene PHOTOS --out DIR

Photos a third as large and 30,000 Gaussians, so that a run is minutes on a CPU; no effects: pictures are compared as
they are rendered.
"""

from collections.abc import Mapping
from typing import Any

from gsjax.config import merge, parse, to_dict
from gsjax.settings import NONE, PRESETS, RATES, Rates, Settings

ON = "base"
LENGTHS = {"a quarter": 0.25, "whole": 1.0}
DENSITY: dict[str, Any] = {"rule": "error", "start": 500, "stop": 4500, "full_by": 0.9, "reset_every": 0}


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """3DGS's rates, then those of `fast`, then its ramp and its surface phase too."""
    from gsjax.pipeline import scaled

    del config, on
    plain = {"rates": to_dict(Rates()), "density": DENSITY}
    rates = {"rates": RATES, "density": DENSITY}
    ramp = {"rates": RATES, "density": {**DENSITY, "start": 50, "stop": 3600, "full_by": 0.6}}
    every_second = {**ramp, "phases": {"surface": {"surface_every": 2}}}
    ways = {"3DGS's rates": plain, "those of fast": rates, "its ramp": ramp, "R every second step": every_second}

    def smaller(way: Mapping[str, Any], share: float) -> dict[str, Any]:
        settings = parse(Settings, merge(PRESETS["balanced"], way))
        return {**to_dict(scaled(settings, share)), "effects": NONE, "downscale": 3, "max_gaussians": 30_000}

    return {f"{name}, {length}": smaller(way, LENGTHS[length]) for length in LENGTHS for name, way in ways.items()}
