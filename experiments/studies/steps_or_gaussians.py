"""What a run of another length is best made of: more steps, or more Gaussians.

Parts of the time of a preset, each filled with some numbers of Gaussians and as many steps as that leaves, by what a
step costs with them (`gsjax.planning.timed_steps.step_cost`); what `--budget` takes is their square root. No effects:
pictures are compared as they are rendered.
"""

from gsjax.config import parse, to_dict
from gsjax.pipeline import scaled
from gsjax.planning.timed_steps import step_cost
from gsjax.settings import NONE, PRESETS, Settings

_TRIED = {  # a preset and so many times its time: shares of its Gaussians
    ("quick", 0.23): (1, 2 / 3, 1 / 2, 1 / 3),
    ("quick", 0.45): (1, 2 / 3, 1 / 2),
    ("quick", 3): (1, 7 / 5, 7 / 4),
    ("fast", 0.5): (1, 0.7),
}


def _filled(preset: str, part: float, share: float) -> dict:
    settings = parse(Settings, PRESETS[preset])
    gaussians = round(share * settings.max_gaussians)
    return to_dict(scaled(settings, part / step_cost(share))) | {"max_gaussians": gaussians, "effects": NONE}


CONFIG: dict = {
    "base": "base",
    "variants": {
        f"{preset} x {part}, {share:.0%} of its Gaussians": _filled(preset, part, share)
        for (preset, part), shares in _TRIED.items()
        for share in shares
    },
}
