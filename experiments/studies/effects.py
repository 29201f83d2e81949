"""What does `--effects auto` bring on real photos, beside `none`?

    python experiments/compare.py effects --scene PHOTOS --out DIR --seeds 3

Plain training. Pictures are scored in all four ways (docs/effects.md); what was simulated stands in every run's
`manifest.json`.
"""

from collections.abc import Mapping
from typing import Any

ON = "photos_short"
EVALUATED = {"three_ways": True}


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Either."""
    del config, on
    return {effects: {"vanilla": True, "effects": effects} for effects in ("none", "auto")}
