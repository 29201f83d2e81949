"""Which rule of growth makes more of the same number of Gaussians?

    python experiments/compare.py growth --scene BUNNY --out DIR --seeds 3
    python experiments/compare.py growth --on photos_short --scene PHOTOS --out DIR --seeds 3

Plain training with every rule of `gsjax.settings.Density`: a new rule is a new row.
"""

from collections.abc import Mapping
from typing import Any, get_args, get_type_hints

from gsjax.settings import Density

ON = "bunny_plane"


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Every rule."""
    del config, on
    return {rule: {"vanilla": True, "density": {"rule": rule}} for rule in get_args(get_type_hints(Density)["rule"])}
