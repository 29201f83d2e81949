"""When a refined mesh settles on its photos: never, late, or early enough for its Gaussians to follow."""

from gsjax.binding.refining import PRESETS

CONFIG: dict = {
    "variants": {
        **{
            name: {"refine": {**PRESETS["fast"], "settle_at": share}}
            for name, share in (("never", 1.0), ("after four fifths", 0.8), ("after three fifths", 0.6))
        },
        "free": {},
    },
}
