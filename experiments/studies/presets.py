"""Which preset earns its time?

    python experiments/compare.py presets --scene FOX --out DIR [--budget 4m]

Photos a third as large, a quarter of the Gaussians and 30,000 at most, every preset scaled to the steps of `fast`, so
that it is minutes on a CPU; `accurate` is then `balanced`. No effects: pictures are compared as they are rendered.
"""

from collections.abc import Mapping
from typing import Any

from gsjax.config import parse, to_dict
from gsjax.settings import NONE, PRESETS, Settings, total_steps

ON = "base"


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Every preset whose schedule differs."""
    from gsjax.pipeline import scaled

    del config, on
    steps = total_steps(parse(Settings, PRESETS["fast"]))

    def smaller(preset: Mapping[str, Any]) -> dict[str, Any]:
        settings = parse(Settings, preset)
        short = to_dict(scaled(settings, steps / total_steps(settings)))
        return {**short, "effects": NONE, "downscale": 3, "max_gaussians": min(settings.max_gaussians // 4, 30_000)}

    return {name: smaller(PRESETS[name]) for name in ("fast", "balanced", "paper_6k_15k")}
