"""What keeps training from learning few photos by heart: fewer Gaussians, some left out, others on what photos show?

    python experiments/compare.py few_photos --scene PHOTOS --out DIR --seeds 3

`quick` in 600 steps on photos of 320 pixels; no effects: pictures are compared as they are rendered.
"""

from collections.abc import Mapping
from typing import Any

from gsjax.config import parse, to_dict
from gsjax.planning.sparse_views import STEREO_SHARE
from gsjax.settings import NONE, PRESETS, Settings, total_steps

ON = "base"
STEPS = 600
SHARES = (0.0, 0.4, 0.6)


def variants(config: Mapping[str, Any], on: str) -> dict[str, dict[str, Any]]:
    """Held back as presets hold back, shares of the Gaussians, and harmonics of a lower degree instead."""
    from gsjax.pipeline import scaled

    del config, on
    quick = parse(Settings, PRESETS["quick"])
    short = to_dict(scaled(quick, STEPS / total_steps(quick)))
    logging = {"evaluate_every": 200, "checkpoint_every": 300}
    short |= {"effects": NONE, "sparse_views": False, "longest_side": 320, "logging": logging}
    shares = {f"{share:.0%}": {**short, "dropout": share} for share in SHARES}
    with_points = {**short, "stereo_points": short["max_gaussians"] // STEREO_SHARE}
    shares |= {"stereo": with_points, "held back": {**short, "sparse_views": True}}
    return shares | {f"degree {degree}": {**short, "sh_degree": degree} for degree in (0, 1)}
