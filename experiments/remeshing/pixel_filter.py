"""Through which filter discs are fitted, with all Gaussians on the mesh."""

from gsjax.binding.refining import PRESETS

CONFIG: dict = {
    "variants": {
        name: {"refine": {**PRESETS["fast"], "pixel_filter": name, "keep_free": False}} for name in ("classic", "mip")
    },
}
