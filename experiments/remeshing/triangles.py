"""Where a refinement's triangles go: by shape alone, or halved where many pixels see them; and twice as many."""

from gsjax.binding.refining import PRESETS

_FAST = PRESETS["fast"]

CONFIG: dict = {
    "variants": {
        "by decimation alone": {"refine": {**_FAST, "halved_share": 0.0}},
        "half of them halved": {"refine": _FAST},
        "three quarters": {"refine": {**_FAST, "halved_share": 0.75}},
        "half, of 60,000": {"refine": {**_FAST, "faces": 60_000}},
        "free": {},
    },
}
