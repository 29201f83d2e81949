"""The presets at their own lengths, and the longest one with the choices of the shorter: which earns its time.

Photos a third as large, a quarter of the Gaussians, so that the paper's 15,000 steps are minutes on a CPU. No effects:
pictures are compared as they are rendered.
"""

from gsjax.config import merge, parse, to_dict
from gsjax.settings import BALANCED, NONE, PRESETS, Settings

_LONG = {
    "phases": [
        {"name": "coarse", "steps": 1000, "image_scale": 2, "density_control": True},
        {"name": "vanilla", "steps": 9000, "density_control": True},
        {"name": "surface", "steps": 5000, "weights": BALANCED["phases"][-1]["weights"]},
    ],
    "density": {"stop": 7500},
    "max_gaussians": 300_000,
}
_ASKED = {**{name: PRESETS[name] for name in ("fast", "balanced", "accurate")}, "long": merge(BALANCED, _LONG)}


def _smaller(preset: dict) -> dict:
    settings = to_dict(parse(Settings, preset))
    return {**settings, "effects": NONE, "downscale": 3, "max_gaussians": settings["max_gaussians"] // 4}


CONFIG: dict = {"base": "base", "variants": {name: _smaller(preset) for name, preset in _ASKED.items()}}
