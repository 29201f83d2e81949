"""Which rates, growth and surface phase earn the time of `balanced`?

    python experiments/compare.py balanced --scene PHOTOS --out DIR

Photos of half their size, half of the steps and of the Gaussians; no effects: pictures are compared as they are
rendered.
"""

from collections.abc import Mapping
from typing import Any

from gsjax.config import merge, parse, to_dict
from gsjax.settings import FAST, NONE, PRESETS, Settings

ON = "base"
SHARE = 0.5  # of the preset's steps and Gaussians


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """3DGS's rates and ramp, then what `fast` has in their place, one after the other."""
    from gsjax.pipeline import scaled

    del config, on
    plain = {"rates": {}, "density": {"rule": "error", "start": 500, "stop": 4500, "full_by": 0.9, "reset_every": 0}}
    rates = {"rates": FAST["rates"]}
    ramp = {"density": {"rule": "error", "start": 50, "stop": 3600, "full_by": 0.6, "reset_every": 0}}
    every_second = {"phases": {"surface": {"surface_every": 2}}}

    def half(*differences: Mapping[str, Any]) -> dict[str, Any]:
        settings = parse(Settings, merge(PRESETS["balanced"], plain, *differences))
        short = to_dict(scaled(settings, SHARE))
        return {**short, "effects": NONE, "downscale": 2, "max_gaussians": int(SHARE * settings.max_gaussians)}

    return {
        "3DGS's rates": half(),
        "rates of fast": half(rates),
        "and its ramp": half(rates, ramp),
        "and R every second step": half(rates, ramp, every_second),
    }
