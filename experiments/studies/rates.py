"""Rates of a short run: 3DGS's, which are for 30,000 steps, against larger ones, and how soon bands of harmonics come.

Plain training, the first steps at half size; every row differs in what it says from the one of `fast`.
"""

from gsjax.config import merge, to_dict
from gsjax.settings import FAST, Rates

_FAST: dict = {
    "vanilla": True,
    "phases": [
        {"name": "coarse", "steps": 300, "image_scale": 2, "density_control": True},
        {"name": "vanilla", "steps": 640, "density_control": True},
    ],
    "density": {"start": 30, "stop": 600},
}
_TIMES = {name: to_dict(Rates())[name] for name in ("means", "scales", "quats", "sh_rest")}


def _rates(**differences: float) -> dict:
    return merge(_FAST, {"rates": differences})


CONFIG: dict = {
    "base": "fox",
    "variants": {
        "fast": _FAST,
        "3DGS's": _rates(**_TIMES, final_share=1.0),
        "3DGS's, falling": _rates(**_TIMES),
        "none falling": _rates(final_share=1.0),
        "means 3DGS's": _rates(means=_TIMES["means"]),
        "harmonics 3DGS's": _rates(sh_rest=_TIMES["sh_rest"]),
        "harmonics twice, a band every 150": merge(_rates(sh_rest=2 * FAST["rates"]["sh_rest"]), {"sh_every": 150}),
        "all twice": _rates(**{name: 2 * FAST["rates"][name] for name in _TIMES}),
    },
}
