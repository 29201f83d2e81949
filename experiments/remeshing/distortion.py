"""2DGS's distortion in a refinement, by its weight."""

from gsjax.binding.refining import PRESETS

CONFIG: dict = {
    "variants": {
        f"{weight:g}": {"refine": {**PRESETS["fast"], "weights": {"distortion": weight}}} for weight in (0.0, 5.0, 50.0)
    },
}
