"""A NeRF-synthetic scene with RGBA images; random backgrounds and supervised coverage keep its surroundings empty."""

from gsjax.settings import PRESETS

CONFIG: dict = {
    "background": "random",
    "phases": [{**phase, "weights": {**phase.get("weights", {}), "alpha": 0.1}} for phase in PRESETS["fast"]["phases"]],
}
