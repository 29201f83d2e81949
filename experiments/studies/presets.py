"""The paper's schedule as it is and with the choices of the shorter presets, beside these: which earns its time.

Photos a third as large, at most 30,000 Gaussians, every preset scaled to the steps of `fast`, so that it is minutes on
a CPU. No effects: pictures are compared as they are rendered.
"""

from gsjax.config import merge, parse, to_dict
from gsjax.pipeline.budget import scaled
from gsjax.settings import BALANCED, NONE, PRESETS, Settings, total_steps

_LONG = merge(
    BALANCED,
    {
        "phases": [
            {"name": "coarse", "steps": 1000, "image_scale": 2, "density_control": True},
            {"name": "vanilla", "steps": 9000, "density_control": True},
            {"name": "surface", "steps": 5000, "weights": BALANCED["phases"][-1]["weights"]},
        ],
        "density": {"stop": 7500},
    },
)
_FAST = parse(Settings, PRESETS["fast"])


def _smaller(preset: dict) -> dict:
    settings = parse(Settings, preset)
    short = to_dict(scaled(settings, total_steps(_FAST) / total_steps(settings)))
    return {**short, "effects": NONE, "downscale": 3, "max_gaussians": min(settings.max_gaussians, 30_000)}


CONFIG: dict = {
    "base": "base",
    "variants": {
        "fast": _smaller(PRESETS["fast"]),
        "balanced": _smaller(BALANCED),
        "paper_6k_15k": _smaller(PRESETS["paper_6k_15k"]),
        "paper_6k_15k, by error": _smaller(_LONG),
    },
}
