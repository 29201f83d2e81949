"""How long a refinement takes and what it brings: steps and triangles, beside the free Gaussians before it."""

from gsjax.binding.refining import PRESETS

CONFIG: dict = {"variants": {"free": {}} | {name: {"refine": PRESETS[name]} for name in ("fast", "balanced", "short")}}
