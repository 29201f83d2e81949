"""The presets at equal steps: which earns its time.

Photos a third as large, a quarter of the Gaussians and 30,000 at most, every preset scaled to the steps of `fast`, so
that it is minutes on a CPU; `accurate` is then `balanced`. No effects: pictures are compared as they are rendered.
"""

from gsjax.config import parse, to_dict
from gsjax.pipeline import scaled
from gsjax.settings import NONE, PRESETS, Settings, total_steps

_FAST = parse(Settings, PRESETS["fast"])


def _smaller(preset: dict) -> dict:
    settings = parse(Settings, preset)
    short = to_dict(scaled(settings, total_steps(_FAST) / total_steps(settings)))
    return {**short, "effects": NONE, "downscale": 3, "max_gaussians": min(settings.max_gaussians // 4, 30_000)}


CONFIG: dict = {
    "base": "base",
    "variants": {name: _smaller(PRESETS[name]) for name in ("fast", "balanced", "paper_6k_15k")},
}
